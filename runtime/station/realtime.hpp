// Real-time rights of the calling thread: memory that stays, a priority, a processor of its own.
#pragma once
#include <optional>
#include <string>
#include <vector>

namespace hapticlod::station {

struct RealTimeRights {
    bool memory_locked = false;
    bool fifo = false;
    std::optional<int> cpu;            // pinned to it
    std::vector<std::string> missing;  // what could not be had, each with its remedy; one line each
};

inline constexpr int kFifoPriority = 80;  // above threaded interrupts (50), below the kernel's own watchdogs (99)

// Asks for everything, takes what it gets. `cpu`: pin to this one; without it, to an isolated processor, else to the
// last allowed one, but only under SCHED_FIFO: an ordinary thread that may not move waits behind others.
[[nodiscard]] RealTimeRights acquire_real_time(std::optional<int> cpu);

}  // namespace hapticlod::station
