#include "station/simulated_device.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace hapticlod::station {
namespace {

constexpr double kStep_s = 1e-4;  // of the integrator; the hand's own frequency is 10 Hz

}  // namespace

SimulatedDevice::SimulatedDevice(HandPath path, const SimulatedBody& body) : path_(std::move(path)), body_(body) {
    const HandTarget start = path_.at(0.0);
    std::copy_n(start.pose.position_mm, 3, position_mm_);
}

DeviceTraits SimulatedDevice::traits() const noexcept {
    return {"sim",
            body_.max_force_n,
            2000.0,
            body_.encoder_mm,
            body_.device_damping_n_s_mm,
            body_.delay_s + body_.read_delay_s};
}

DeviceReading SimulatedDevice::read(std::int64_t now_ns) noexcept {
    if (!started_) start_ns_ = now_ns;
    started_ = true;
    // What is read now happened `read_delay_s` ago: forces written since then are still to come in any case.
    advance(std::max(0.0, static_cast<double>(now_ns - start_ns_) * 1e-9 - body_.read_delay_s));
    DeviceReading reading{path_.at(time_s_).pose, time_s_};
    for (int axis = 0; axis < 3; ++axis) {
        const double step = body_.encoder_mm;
        reading.pose.position_mm[axis] = step > 0.0 ? std::round(position_mm_[axis] / step) * step : position_mm_[axis];
    }
    return reading;
}

void SimulatedDevice::write(std::int64_t now_ns, const double force_n[3], bool) noexcept {
    if (waiting_ == pending_.size()) {  // a delay of more than 256 ticks: the oldest is felt early
        first_ = (first_ + 1) % pending_.size();
        --waiting_;
    }
    PendingForce& entry = pending_[(first_ + waiting_++) % pending_.size()];
    entry.from_s = static_cast<double>(now_ns - start_ns_) * 1e-9 + body_.delay_s;
    std::copy_n(force_n, 3, entry.force_n);
}

void SimulatedDevice::advance(double until_s) noexcept {
    // A force due within a nanosecond of the reading belongs to the time after it, whatever the rounding.
    while (waiting_ > 0 && pending_[first_].from_s <= until_s + 1e-9) {
        integrate(std::min(pending_[first_].from_s, until_s));
        std::copy_n(pending_[first_].force_n, 3, force_n_);
        first_ = (first_ + 1) % pending_.size();
        --waiting_;
    }
    integrate(until_s);
}

// Classic fourth-order Runge-Kutta under the force that is felt now.
void SimulatedDevice::integrate(double until_s) noexcept {
    const double span = until_s - time_s_;
    if (span <= 0.0) return;
    const auto steps = static_cast<int>(std::ceil(span / kStep_s));
    const double h = span / steps;
    const double per_mass = 1000.0 / (body_.hand_mass_kg + body_.device_mass_kg);  // N -> mm/s^2
    // Friction turns over within a speed that the integrator's step can follow.
    const double turn_mm_s = std::max(1.0, 2.0 * body_.device_friction_n * per_mass * kStep_s);
    for (int i = 0; i < steps; ++i) {
        const double t = time_s_ + h * i;
        const HandTarget targets[3] = {path_.at(t), path_.at(t + 0.5 * h), path_.at(t + h)};
        for (int axis = 0; axis < 3; ++axis) {
            const auto acceleration = [&](const HandTarget& target, double x, double v) {
                const double pull = body_.hand_stiffness_n_mm * (target.pose.position_mm[axis] - x) +
                                    body_.hand_damping_n_s_mm * (target.velocity_mm_s[axis] - v);
                const double drag =
                    body_.device_damping_n_s_mm * v + body_.device_friction_n * std::tanh(v / turn_mm_s);
                return per_mass * (pull - drag + force_n_[axis]);
            };
            const double x = position_mm_[axis], v = velocity_mm_s_[axis];
            const double a1 = acceleration(targets[0], x, v);
            const double v2 = v + 0.5 * h * a1;
            const double a2 = acceleration(targets[1], x + 0.5 * h * v, v2);
            const double v3 = v + 0.5 * h * a2;
            const double a3 = acceleration(targets[1], x + 0.5 * h * v2, v3);
            const double v4 = v + h * a3;
            const double a4 = acceleration(targets[2], x + h * v3, v4);
            position_mm_[axis] = x + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4);
            velocity_mm_s_[axis] = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4);
        }
    }
    time_s_ = until_s;
}

}  // namespace hapticlod::station
