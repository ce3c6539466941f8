#include "io/motion_interpolation.hpp"

#include <algorithm>
#include <cmath>

namespace hapticlod {
namespace {

// Slope of one coordinate at a row: central difference, one-sided at the ends.
double slope(std::span<const MotionRow> rows, std::size_t row, int axis) {
    const MotionRow& before = rows[row == 0 ? 0 : row - 1];
    const MotionRow& after = rows[std::min(row + 1, rows.size() - 1)];
    return (after.position_mm[axis] - before.position_mm[axis]) / (after.time_s - before.time_s);
}

// Rows are so close that this equals the slerp.
void turn(const double* from, const double* to, double share, double* out) {
    double dot = 0.0;
    for (int i = 0; i < 4; ++i) dot += from[i] * to[i];
    double length2 = 0.0;
    for (int i = 0; i < 4; ++i) {
        out[i] = (1.0 - share) * from[i] + share * (dot < 0.0 ? -to[i] : to[i]);
        length2 += out[i] * out[i];
    }
    for (int i = 0; i < 4; ++i) out[i] /= std::sqrt(length2);
}

}  // namespace

MotionSample sample_motion(std::span<const MotionRow> rows, double time_s) noexcept {
    const auto later = std::upper_bound(rows.begin() + 1, rows.end() - 1, time_s,
                                        [](double value, const MotionRow& row) { return value < row.time_s; });
    const auto row = static_cast<std::size_t>(later - rows.begin()) - 1;
    const MotionRow& from = rows[row];
    const MotionRow& to = rows[row + 1];
    const double step = to.time_s - from.time_s;
    const double s = std::clamp((time_s - from.time_s) / step, 0.0, 1.0);
    MotionSample sample;
    for (int axis = 0; axis < 3; ++axis) {
        const double p0 = from.position_mm[axis], p1 = to.position_mm[axis];
        const double m0 = step * slope(rows, row, axis), m1 = step * slope(rows, row + 1, axis);
        const double bend = 2.0 * (p0 - p1) + m0 + m1;
        const double pull = 3.0 * (p1 - p0) - 2.0 * m0 - m1;
        sample.position_mm[axis] = p0 + s * (m0 + s * (pull + s * bend));
        sample.velocity_mm_s[axis] = (m0 + s * (2.0 * pull + 3.0 * s * bend)) / step;
    }
    turn(from.orientation, to.orientation, s, sample.orientation);
    return sample;
}

bool has_rate(std::span<const MotionRow> rows, double loop_hz) {
    for (std::size_t i = 0; i < rows.size(); ++i) {
        const double expected_s = rows.front().time_s + static_cast<double>(i) / loop_hz;
        if (std::abs(rows[i].time_s - expected_s) * loop_hz > 0.01) return false;
    }
    return true;
}

std::vector<MotionRow> resample_motion(std::span<const MotionRow> rows, double loop_hz) {
    const double start_s = rows.front().time_s;
    const auto count = static_cast<std::size_t>(std::floor((rows.back().time_s - start_s) * loop_hz + 1e-6)) + 1;
    std::vector<MotionRow> out(count);
    for (std::size_t i = 0; i < count; ++i) {
        out[i].time_s = start_s + static_cast<double>(i) / loop_hz;
        const MotionSample sample = sample_motion(rows, out[i].time_s);
        std::copy_n(sample.position_mm, 3, out[i].position_mm);
        std::copy_n(sample.orientation, 4, out[i].orientation);
    }
    return out;
}

}  // namespace hapticlod
