#include "station/realtime.hpp"

#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <fstream>

namespace hapticlod::station {
namespace {

// Touches the stack the loop may need, so that it is resident before the first tick.
void touch_stack() {
    std::array<unsigned char, 256 * 1024> page_walk;
    volatile unsigned char* bytes = page_walk.data();
    for (std::size_t i = 0; i < page_walk.size(); i += 4096) bytes[i] = 0;
}

// First processor of /sys/devices/system/cpu/isolated ("2-3,6"), if there is one.
std::optional<int> isolated_cpu() {
    std::ifstream file("/sys/devices/system/cpu/isolated");
    std::string text;
    int cpu = 0;
    if (!std::getline(file, text)) return std::nullopt;
    if (std::from_chars(text.data(), text.data() + text.size(), cpu).ec != std::errc()) return std::nullopt;
    return cpu;
}

std::optional<int> last_allowed_cpu() {
    cpu_set_t allowed;
    if (::sched_getaffinity(0, sizeof(allowed), &allowed) != 0 || CPU_COUNT(&allowed) < 2) return std::nullopt;
    for (int cpu = CPU_SETSIZE - 1; cpu >= 0; --cpu) {
        if (CPU_ISSET(cpu, &allowed)) return cpu;
    }
    return std::nullopt;
}

std::string reason(int error) { return std::string(" (") + std::strerror(error) + ")"; }

}  // namespace

RealTimeRights acquire_real_time(std::optional<int> cpu) {
    RealTimeRights rights;
    rights.memory_locked = ::mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    if (!rights.memory_locked) {
        rights.missing.push_back(
            "memory is not locked" + reason(errno) +
            ": page faults may delay a tick; run as root, or set 'memlock unlimited' for your user "
            "in /etc/security/limits.conf and log in again");
    }
    touch_stack();

    sched_param priority{};
    priority.sched_priority = kFifoPriority;
    rights.fifo = ::sched_setscheduler(0, SCHED_FIFO, &priority) == 0;
    if (!rights.fifo) {
        rights.missing.push_back("no SCHED_FIFO priority" + reason(errno) +
                                 ": other programs may delay the loop by milliseconds; run as root, or set 'rtprio 90' "
                                 "for your user in /etc/security/limits.conf and log in again");
        (void)::prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0);  // ordinary threads wake up to 50 us late on purpose
    }

    const bool asked = cpu.has_value();
    if (!asked) cpu = isolated_cpu();
    if (!cpu && rights.fifo) cpu = last_allowed_cpu();
    if (!cpu) return rights;
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(static_cast<std::size_t>(*cpu), &one);
    if (::sched_setaffinity(0, sizeof(one), &one) == 0) {
        rights.cpu = cpu;
    } else if (asked) {
        rights.missing.push_back("not pinned to processor " + std::to_string(*cpu) + reason(errno) +
                                 ": the loop may move between processors; choose another with --cpu");
    }
    return rights;
}

}  // namespace hapticlod::station
