// A hand without manners: strokes up to 1 m/s, taps, rests, leaps, presses through the middle, turns, and now and then
// a pose or a time that is none. Endless, and the same for the same seed.
#pragma once
#include <limits>

#include "tests/soak_scene.hpp"

namespace hapticlod::test {

struct SoakStep {
    Pose pose;
    double time_s;
};

class SoakHand {
public:
    SoakHand(const SoakCase& c, std::uint64_t seed) : case_(c), dice_(seed ^ 0x5bd1e995u), at_(anchor(1.4, 1.6)) {
        for (const BallData& b : c.tool)
            reach_ = std::max(reach_, length({b.centre_mm[0], b.centre_mm[1], b.centre_mm[2]}) + b.radius_mm);
        turns_ = c.tool.size() > 1;
    }

    SoakStep next() {
        if (left_ == 0) begin_stroke();
        --left_;
        const double s = 1.0 - static_cast<double>(left_) / static_cast<double>(ticks_);
        at_ = from_ + (to_ - from_) * (s * s * s * (10.0 + s * (6.0 * s - 15.0)));  // minimum jerk
        time_s_ += dice_.chance(0.02) ? dice_.between(2e-4, 4e-3) : 1e-3;
        SoakStep step{{}, time_s_};
        for (std::size_t k = 0; k < 3; ++k) step.pose.position_mm[k] = at_[k] + case_.config.origin_mm[k];
        if (turns_) turn();
        for (std::size_t k = 0; k < 4; ++k) step.pose.orientation[k] = q_[k];
        if (dice_.chance(5e-4)) spoil(step);
        return step;
    }

private:
    // A place whose depth is between two heights: in body radii, or in mm over the plate.
    Point anchor(double low, double high) {
        if (!case_.body->plate) return dice_.vector(low * kBodyRadiusMm, high * kBodyRadiusMm);
        const double border = dice_.chance(0.15) ? 1.15 : 0.8;
        const double side = dice_.chance(0.5) ? 1.0 : -1.0;
        return {dice_.between(-border, border) * kPlateHalfMm, dice_.between(-border, border) * kPlateHalfMm,
                side * (dice_.between(low, high) - 1.0) * 5.0};
    }

    void begin_stroke() {
        from_ = at_;
        const double kind = dice_.between(0.0, 1.0);
        double speed_mm_s = std::exp(dice_.between(std::log(5.0), std::log(500.0)));  // peak: 1.9 times the mean
        if (kind < 0.5) {
            // Along the surface and a little into it.
            const double lift = 0.1 * reach_;
            to_ = anchor(0.93 + lift, 1.02 + lift);
        } else if (kind < 0.7) {
            // A tap: straight in and, with the next stroke, wherever.
            const Point way = case_.body->plate ? Point{0.0, 0.0, from_[2] > 0.0 ? -1.0 : 1.0}
                                                : from_ * (-1.0 / std::max(length(from_), 1e-3));
            to_ = from_ + way * dice_.between(0.5, 4.0);
        } else if (kind < 0.8) {
            to_ = anchor(1.1, 1.5);
        } else if (kind < 0.88) {
            to_ = from_ + dice_.vector(0.0, 0.05);
            speed_mm_s = 1.0;
        } else if (kind < 0.95) {
            to_ = from_ * dice_.between(-1.2, 0.3);
            speed_mm_s = 520.0;
        } else {
            from_ = to_ = anchor(0.9, 1.5);  // a leap, shorter than the body
        }
        // Never so far that it counts as a jump.
        if (const double far = length(to_); far > 1.6 * kBodyRadiusMm) to_ = to_ * (1.6 * kBodyRadiusMm / far);
        ticks_ = left_ = std::max<std::size_t>(1, static_cast<std::size_t>(length(to_ - from_) / speed_mm_s * 1e3));
    }

    void turn() {
        if (dice_.chance(0.01)) {
            const double fastest = dice_.chance(0.3) ? 0.02 : 0.002;  // rad per tick
            for (double& s : spin_) s = dice_.between(-fastest, fastest);
        }
        double size = 0.0;
        const double half[3] = {0.5 * spin_[0], 0.5 * spin_[1], 0.5 * spin_[2]};
        const double q[4] = {q_[0] - half[0] * q_[1] - half[1] * q_[2] - half[2] * q_[3],
                             q_[1] + half[0] * q_[0] + half[1] * q_[3] - half[2] * q_[2],
                             q_[2] + half[1] * q_[0] + half[2] * q_[1] - half[0] * q_[3],
                             q_[3] + half[2] * q_[0] + half[0] * q_[2] - half[1] * q_[1]};
        for (const double v : q) size += v * v;
        for (std::size_t k = 0; k < 4; ++k) q_[k] = q[k] / std::sqrt(size);
    }

    void spoil(SoakStep& step) {
        const double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
        switch (dice_.below(8)) {
            case 0:
                step.pose.position_mm[dice_.below(3)] = nan;
                break;
            case 1:
                step.pose.position_mm[dice_.below(3)] = inf;
                break;
            case 2:
                step.pose.orientation[dice_.below(4)] = nan;
                break;
            case 3:
                step.pose.orientation[0] = step.pose.orientation[1] = step.pose.orientation[2] = 0.0;
                break;
            case 4:
                step.time_s = nan;
                break;
            case 5:
                step.time_s -= 1e-3;
                break;
            case 6:
                step.time_s -= 3e-3;
                break;
            default:
                step.pose.position_mm[dice_.below(3)] += 1e4;
                break;  // a jump: contact begins anew, twice
        }
    }

    const SoakCase& case_;
    Dice dice_;
    Point at_, from_{}, to_{};
    double q_[4] = {1.0, 0.0, 0.0, 0.0}, spin_[3] = {};
    double reach_ = 0.0, time_s_ = 0.0;
    std::size_t ticks_ = 1, left_ = 0;
    bool turns_ = false;
};

}  // namespace hapticlod::test
