// Hand motion as the runtime reads it: one row per sample. Also the layout of section GOLDEN_MOTION.
#pragma once
#include <cstddef>
#include <span>
#include <string>

namespace hapticlod {

struct MotionRow {
    double time_s;
    double position_mm[3];  // HIP, scan frame
    double orientation[4];  // unit quaternion w x y z, tool frame -> scan frame
};
static_assert(sizeof(MotionRow) == 64);

// The first row that cannot be right and why ("row 12 holds a number that is not finite"); empty: usable.
// At least two rows, finite, time strictly increasing, orientations of length 1 within 0.1 %.
[[nodiscard]] std::string check_motion(std::span<const MotionRow> rows);

}  // namespace hapticlod
