// The loop's sense of time. Deadlines are absolute, so the phase never drifts: deadline i is start + i periods.
#pragma once
#include <cstdint>

namespace hapticlod::station {

class LoopClock {
public:
    virtual ~LoopClock() = default;
    [[nodiscard]] virtual std::int64_t now_ns() noexcept = 0;
    // Returns at the deadline, or early when a signal arrived; at once when it has passed.
    virtual void sleep_until(std::int64_t deadline_ns) noexcept = 0;
    // False where time is simulated: then nothing that was measured with a real clock may change the outcome.
    [[nodiscard]] virtual bool real() const noexcept = 0;
};

// CLOCK_MONOTONIC, slept on with TIMER_ABSTIME.
class MonotonicClock final : public LoopClock {
public:
    [[nodiscard]] std::int64_t now_ns() noexcept override;
    void sleep_until(std::int64_t deadline_ns) noexcept override;
    [[nodiscard]] bool real() const noexcept override { return true; }
};

// Every sleep ends exactly at its deadline, at once: a run is repeatable and takes no longer than its computing.
class VirtualClock final : public LoopClock {
public:
    [[nodiscard]] std::int64_t now_ns() noexcept override { return now_ns_; }
    void sleep_until(std::int64_t deadline_ns) noexcept override {
        if (deadline_ns > now_ns_) now_ns_ = deadline_ns;
    }
    [[nodiscard]] bool real() const noexcept override { return false; }

private:
    std::int64_t now_ns_ = 0;
};

// Deadlines of a loop. After an overrun the ticks that were missed are left out and the phase is kept.
class Schedule {
public:
    Schedule(std::int64_t start_ns, double period_s) : start_ns_(start_ns), period_ns_(period_s * 1e9) {}
    [[nodiscard]] std::int64_t deadline_ns() const;
    [[nodiscard]] std::uint64_t index() const { return index_; }  // of the deadline, from 1
    // Moves on to the first deadline after `now_ns`; returns how many were left out.
    std::uint64_t advance(std::int64_t now_ns);

private:
    std::int64_t start_ns_;
    double period_ns_;  // not a whole number at, say, 3 kHz: deadlines are computed, never summed up
    std::uint64_t index_ = 1;
};

}  // namespace hapticlod::station
