// The last step before the device: finite, within the force and slew limits, softly engaged. Direction is kept.
#pragma once
#include <algorithm>

#include "core/layout.hpp"
#include "core/vec.hpp"

namespace hapticlod {

class ForceGate {
public:
    void reset() { last_ = {}, engage_left_s_ = 0.0; }
    void engage(double seconds) { engage_left_s_ = seconds; }

    Vec3 apply(const ConfigData& c, Vec3 force, double dt_s, std::uint32_t& errors) {
        if (!force.finite()) {
            errors |= kErrForceNotFinite;
            return last_ = {};
        }
        if (engage_left_s_ > 0.0) {
            force = force * std::clamp(1.0 - engage_left_s_ / c.engage_s, 0.0, 1.0);
            engage_left_s_ -= dt_s;
        }
        const double size = norm(force);
        if (c.max_force_n > 0.0 && size > c.max_force_n) {
            errors |= kErrForceClamped;
            force = force * (c.max_force_n / size);
        }
        if (c.max_slew_n_s > 0.0) {
            const Vec3 step = force - last_;
            const double length = norm(step), most = c.max_slew_n_s * dt_s;
            if (length > most) {
                errors |= kErrSlewLimited;
                force = last_ + step * (most / length);
            }
        }
        return last_ = force;
    }

private:
    Vec3 last_;
    double engage_left_s_ = 0.0;
};

}  // namespace hapticlod
