// Ctrl-C and SIGTERM ask the loop to end in order: force 0, summary, exit.
#pragma once
#include <atomic>

namespace hapticlod::station {

// Installs the handlers, once per process. The flag becomes true at the first signal; a second one kills.
[[nodiscard]] const std::atomic<bool>& stop_signal();

}  // namespace hapticlod::station
