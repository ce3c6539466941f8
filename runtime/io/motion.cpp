#include "io/motion.hpp"

#include <cmath>

namespace hapticlod {

std::string check_motion(std::span<const MotionRow> rows) {
    if (rows.size() < 2) return "has " + std::to_string(rows.size()) + " rows, a motion needs at least 2";
    for (std::size_t i = 0; i < rows.size(); ++i) {
        const MotionRow& row = rows[i];
        const std::string at = "row " + std::to_string(i + 1) + " ";
        double length2 = 0.0;
        bool finite = std::isfinite(row.time_s);
        for (const double value : row.position_mm) finite = finite && std::isfinite(value);
        for (const double value : row.orientation) length2 += value * value;
        if (!finite || !std::isfinite(length2)) return at + "holds a number that is not finite";
        if (std::abs(std::sqrt(length2) - 1.0) > 1e-3) return at + "has an orientation that is not a unit quaternion";
        if (i > 0 && row.time_s <= rows[i - 1].time_s) return at + "does not come after the row before";
    }
    return {};
}

}  // namespace hapticlod
