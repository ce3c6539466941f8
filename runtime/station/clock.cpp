#include "station/clock.hpp"

#include <time.h>

#include <algorithm>
#include <cmath>

namespace hapticlod::station {

std::int64_t MonotonicClock::now_ns() noexcept {
    timespec now{};
    ::clock_gettime(CLOCK_MONOTONIC, &now);
    return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

void MonotonicClock::sleep_until(std::int64_t deadline_ns) noexcept {
    const timespec deadline{static_cast<time_t>(deadline_ns / 1'000'000'000),
                            static_cast<long>(deadline_ns % 1'000'000'000)};
    (void)::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, nullptr);
}

std::int64_t Schedule::deadline_ns() const {
    return start_ns_ + std::llround(static_cast<double>(index_) * period_ns_);
}

std::uint64_t Schedule::advance(std::int64_t now_ns) {
    ++index_;
    if (deadline_ns() > now_ns) return 0;
    const std::uint64_t next = index_;
    index_ = std::max(next, static_cast<std::uint64_t>(static_cast<double>(now_ns - start_ns_) / period_ns_));
    while (deadline_ns() <= now_ns) ++index_;
    return index_ - next;
}

}  // namespace hapticlod::station
