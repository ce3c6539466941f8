// Which level the speed asks for: a Schmitt trigger per threshold with a minimum dwell (Zhou et al. 2009, section 2.2,
// is hysteresis 0 and dwell 0). A policy is nothing but the number that drives it.
#pragma once
#include <algorithm>
#include <cmath>
#include <limits>

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

// The distance policy's number: how far the tool is from the surface. Looking is dear, so it is looked at again only
// where a threshold may lie between what was seen and where the tool can be by now.
class ProbeDistance {
public:
    void reset() { moved_mm_ = std::numeric_limits<double>::infinity(); }
    void moved(double mm) { moved_mm_ += mm; }
    void seen(double mm) { mm_ = mm, moved_mm_ = 0.0; }
    [[nodiscard]] double mm() const { return mm_; }

    // Whether every threshold is on the side where it was when the distance was seen.
    [[nodiscard]] bool decides(const ConfigData& c) const {
        for (std::uint32_t i = 0; i + 1 < c.level_count; ++i)
            for (const double sign : {-1.0, 1.0})
                if (std::abs(mm_ - c.speeds_mm_s[i] * (1.0 + sign * c.hysteresis)) <= moved_mm_) return false;
        return true;
    }

    // Beyond this it does not matter how far it is.
    [[nodiscard]] static double bound_mm(const ConfigData& c) {
        return c.level_count < 2 ? 0.0 : 1.5 * c.speeds_mm_s[c.level_count - 2] * (1.0 + c.hysteresis);
    }

private:
    double mm_ = 0.0, moved_mm_ = std::numeric_limits<double>::infinity();
};

}  // namespace hapticlod
