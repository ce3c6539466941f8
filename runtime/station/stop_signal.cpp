#include "station/stop_signal.hpp"

#include <csignal>

namespace hapticlod::station {
namespace {

std::atomic<bool> stop_requested{false};
static_assert(std::atomic<bool>::is_always_lock_free);  // a handler may not take a lock

extern "C" void on_signal(int) { stop_requested.store(true); }

}  // namespace

const std::atomic<bool>& stop_signal() {
    struct sigaction action {};
    action.sa_handler = on_signal;
    action.sa_flags = SA_RESETHAND;  // no SA_RESTART: the sleep must end
    sigemptyset(&action.sa_mask);
    ::sigaction(SIGINT, &action, nullptr);
    ::sigaction(SIGTERM, &action, nullptr);
    return stop_requested;
}

}  // namespace hapticlod::station
