// A level switch moves the contact by the levels' distance there. The old position is kept as an offset that decays
// linearly over tau_b, so that the force stays continuous; tau_b = 0 is the paper. The offset also fades with the
// depth, so that no force is left when the tool leaves the surface.
#pragma once
#include <algorithm>

#include "core/vec.hpp"

namespace hapticlod {

class Blend {
public:
    void reset() { left_s_ = 0.0; }
    void begin(const Vec3& offset, double duration_s, double depth_mm) {
        offset_ = offset;
        duration_s_ = left_s_ = duration_s;
        depth_mm_ = depth_mm;
    }
    void advance(double dt_s) { left_s_ = std::max(left_s_ - dt_s, 0.0); }

    // What is left of a step that fades with time alone.
    [[nodiscard]] double share() const { return left_s_ > 0.0 ? left_s_ / duration_s_ : 0.0; }

    [[nodiscard]] Vec3 rendered(const Vec3& scp, double depth_mm) const {
        if (left_s_ <= 0.0) return scp;
        const double fade = depth_mm_ > 0.0 ? std::min(depth_mm / depth_mm_, 1.0) : 1.0;
        return scp + offset_ * (fade * left_s_ / duration_s_);
    }

private:
    Vec3 offset_;
    double duration_s_ = 1.0, left_s_ = 0.0, depth_mm_ = 0.0;
};

}  // namespace hapticlod
