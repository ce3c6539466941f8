// Which level the speed asks for: a Schmitt trigger per threshold with a minimum dwell (Zhou et al. 2009, section 2.2,
// is hysteresis 0 and dwell 0).
#pragma once
#include <algorithm>

#include "core/layout.hpp"

namespace hapticlod {

class LevelSwitch {
public:
    void reset() { level_ = 0, since_s_ = 1e30, floor_ = 0; }
    void set_floor(std::uint32_t level) { floor_ = level; }
    [[nodiscard]] std::uint32_t level() const { return level_; }

    // `measure` is what the thresholds are in: speed (mm/s), or distance (mm) under the distance policy.
    std::uint32_t update(const ConfigData& c, double measure, double dt_s) {
        since_s_ += dt_s;
        const std::uint32_t last = c.level_count - 1;
        std::uint32_t wanted = level_;
        if (since_s_ >= c.dwell_s) {
            while (wanted < last && measure > c.speeds_mm_s[wanted] * (1.0 + c.hysteresis)) ++wanted;
            while (wanted > 0 && measure < c.speeds_mm_s[wanted - 1] * (1.0 - c.hysteresis)) --wanted;
        }
        wanted = std::max(wanted, std::min(floor_, last));
        if (wanted != level_) level_ = wanted, since_s_ = 0.0;
        return level_;
    }

private:
    std::uint32_t level_ = 0, floor_ = 0;
    double since_s_ = 1e30;
};

}  // namespace hapticlod
