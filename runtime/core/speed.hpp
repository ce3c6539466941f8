// Hand speed from positions and device time stamps. A raw difference of a quantised position is useless (a 0.023 mm
// encoder gives 10 mm/s of noise at 1 kHz), so velocity passes a one-pole low-pass; cut-off 0 keeps the paper's raw
// one.
#pragma once
#include <numbers>

#include "core/vec.hpp"

namespace hapticlod {

class SpeedEstimator {
public:
    void reset() { started_ = false, velocity_ = {}; }

    // Velocity in mm/s after this sample. dt_s > 0.
    const Vec3& update(const Vec3& position, double dt_s, double cutoff_hz) {
        if (started_) {
            const Vec3 raw = (position - last_) * (1.0 / dt_s);
            const double alpha = cutoff_hz > 0.0 ? 1.0 - std::exp(-2.0 * std::numbers::pi * cutoff_hz * dt_s) : 1.0;
            velocity_ += (raw - velocity_) * alpha;
        }
        started_ = true;
        last_ = position;
        return velocity_;
    }
    [[nodiscard]] const Vec3& velocity() const { return velocity_; }

private:
    Vec3 last_, velocity_;
    bool started_ = false;
};

}  // namespace hapticlod
