// A motion between its rows: cubic Hermite in position, normalised linear in orientation.
#pragma once
#include <span>
#include <vector>

#include "io/motion.hpp"

namespace hapticlod {

struct MotionSample {
    double position_mm[3];
    double velocity_mm_s[3];
    double orientation[4];
};

// Rows as check_motion accepts them; times outside them are held at the ends. Allocates nothing.
[[nodiscard]] MotionSample sample_motion(std::span<const MotionRow> rows, double time_s) noexcept;

// Whether the rows already are one per period, each within a hundredth of one.
[[nodiscard]] bool has_rate(std::span<const MotionRow> rows, double loop_hz);

// Rows at t0, t0 + 1/loop_hz, ... up to the last time.
[[nodiscard]] std::vector<MotionRow> resample_motion(std::span<const MotionRow> rows, double loop_hz);

}  // namespace hapticlod
