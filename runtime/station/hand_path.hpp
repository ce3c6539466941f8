// Where the simulated hand wants to be at any time: a motion played forward, then backward, and so on for ever.
//
// Playing backward keeps the hand on the surface it was recorded on; a straight way home would cut through the scan.
// The playing rate goes from 1 to -1 linearly at each end (and from 0 to 1 at the start), so position and velocity
// are continuous everywhere.
#pragma once
#include <vector>

#include "core/renderer.hpp"
#include "io/motion.hpp"

namespace hapticlod::station {

struct HandTarget {
    Pose pose;
    double velocity_mm_s[3];
};

class HandPath {
public:
    // Rows as check_motion accepts them.
    explicit HandPath(std::vector<MotionRow> rows);

    // time_s >= 0, counted from the start of playing. Cubic between rows; allocates nothing.
    [[nodiscard]] HandTarget at(double time_s) const noexcept;

    // From one end of the motion to the other.
    [[nodiscard]] double pass_s() const { return duration_s_ + ease_s_; }

private:
    std::vector<MotionRow> rows_;
    double duration_s_;
    double ease_s_;
};

}  // namespace hapticlod::station
