#include "station/stop_signal.hpp"

#include <poll.h>
#include <termios.h>
#include <unistd.h>

#include <csignal>

namespace hapticlod::station {
namespace {

std::atomic<bool> stop_requested{false}, emergency_requested{false};
static_assert(std::atomic<bool>::is_always_lock_free);  // a handler may not take a lock

extern "C" void on_stop(int) { stop_requested.store(true); }
extern "C" void on_emergency(int) { emergency_requested.store(true); }

void install(int number, void (*handler)(int), int flags) {
    struct sigaction action {};
    action.sa_handler = handler;
    action.sa_flags = flags;  // no SA_RESTART: the sleep must end
    sigemptyset(&action.sa_mask);
    ::sigaction(number, &action, nullptr);
}

}  // namespace

const std::atomic<bool>& stop_signal() {
    install(SIGINT, on_stop, static_cast<int>(SA_RESETHAND));
    install(SIGTERM, on_stop, static_cast<int>(SA_RESETHAND));
    return stop_requested;
}

std::atomic<bool>& emergency_signal() {
    install(SIGUSR1, on_emergency, 0);
    return emergency_requested;
}

struct EmergencyKey::Terminal {
    termios before{};
};

EmergencyKey::EmergencyKey() {
    auto terminal = std::make_unique<Terminal>();
    // A background job that touches its terminal is stopped by the kernel: that must not happen to a loop.
    if (::isatty(STDIN_FILENO) == 0 || ::tcgetpgrp(STDIN_FILENO) != ::getpgrp()) return;
    if (::tcgetattr(STDIN_FILENO, &terminal->before) != 0) return;
    termios raw = terminal->before;
    raw.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);  // keys at once; Ctrl-C still is a signal
    if (::tcsetattr(STDIN_FILENO, TCSANOW, &raw) != 0) return;
    terminal_ = std::move(terminal);
    thread_ = std::thread([this] {
        while (!end_.load(std::memory_order_acquire)) {
            pollfd input{STDIN_FILENO, POLLIN, 0};
            if (::poll(&input, 1, 50) <= 0) continue;
            char key = 0;
            if (::read(STDIN_FILENO, &key, 1) != 1) return;  // the terminal is gone
            emergency_signal().store(true);
        }
    });
}

EmergencyKey::~EmergencyKey() {
    end_.store(true, std::memory_order_release);
    if (thread_.joinable()) thread_.join();
    if (terminal_) (void)::tcsetattr(STDIN_FILENO, TCSANOW, &terminal_->before);
}

}  // namespace hapticlod::station
