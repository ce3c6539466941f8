// Reads hand motion from CSV or TSV text. Header required: t_s, x_mm, y_mm, z_mm in any order, optionally qw, qx, qy,
// qz (all or none); other columns are ignored, lines that start with # and blank lines are skipped. A column seg must
// not change: a station plays one motion.
#pragma once
#include <string>
#include <string_view>
#include <vector>

#include "io/motion.hpp"
#include "io/result.hpp"

namespace hapticlod {

// Faults name the line: "probe.csv:17: x_mm is not a number ('1,5'); ...". Rows are kept as they are.
[[nodiscard]] Result<std::vector<MotionRow>> parse_motion_csv(std::string_view text, const std::string& name);

[[nodiscard]] Result<std::vector<MotionRow>> read_motion_csv(const std::string& path);

}  // namespace hapticlod
