#include "station/hand_path.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "io/motion_interpolation.hpp"

namespace hapticlod::station {
namespace {

constexpr double kEase_s = 0.2;

}  // namespace

HandPath::HandPath(std::vector<MotionRow> rows)
    : rows_(std::move(rows)),
      duration_s_(rows_.back().time_s - rows_.front().time_s),
      ease_s_(std::min(kEase_s, duration_s_)) {}

HandTarget HandPath::at(double time_s) const noexcept {
    // One pass takes D + e: rate 0 -> 1 over e, rate 1, then 1 -> 0 over e; the covered time is D.
    const double pass = pass_s();
    const double phase = std::fmod(std::max(0.0, time_s), 2.0 * pass);
    const bool backward = phase >= pass;
    const double t = backward ? 2.0 * pass - phase : phase;
    double place = t - 0.5 * ease_s_;
    double rate = 1.0;
    if (t < ease_s_) {
        place = 0.5 * t * t / ease_s_;
        rate = t / ease_s_;
    } else if (t > duration_s_) {
        const double left = pass - t;
        place = duration_s_ - 0.5 * left * left / ease_s_;
        rate = left / ease_s_;
    }
    if (backward) rate = -rate;

    const MotionSample sample = sample_motion(rows_, rows_.front().time_s + place);
    HandTarget target{};
    std::copy_n(sample.position_mm, 3, target.pose.position_mm);
    std::copy_n(sample.orientation, 4, target.pose.orientation);
    for (int axis = 0; axis < 3; ++axis) target.velocity_mm_s[axis] = rate * sample.velocity_mm_s[axis];
    return target;
}

}  // namespace hapticlod::station
