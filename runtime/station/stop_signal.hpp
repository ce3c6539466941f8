// How an operator ends a run. Ctrl-C and SIGTERM: in order, force 0, summary, exit. SIGUSR1, or any key where standard
// input is a terminal: the emergency stop, SAFE at the next tick.
#pragma once
#include <atomic>
#include <memory>
#include <thread>

namespace hapticlod::station {

// Installs the handlers, once per process. The flag becomes true at the first signal; a second one kills.
[[nodiscard]] const std::atomic<bool>& stop_signal();

// The operator's emergency stop; SIGUSR1 sets it from the first call on.
[[nodiscard]] std::atomic<bool>& emergency_signal();

// While it lives, any key pressed in the terminal is the emergency stop. Does nothing without a terminal.
class EmergencyKey {
public:
    EmergencyKey();
    ~EmergencyKey();
    EmergencyKey(const EmergencyKey&) = delete;
    EmergencyKey& operator=(const EmergencyKey&) = delete;
    [[nodiscard]] bool watching() const { return thread_.joinable(); }

private:
    struct Terminal;
    std::unique_ptr<Terminal> terminal_;
    std::atomic<bool> end_{false};
    std::thread thread_;
};

}  // namespace hapticlod::station
