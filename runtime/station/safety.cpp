#include "station/safety.hpp"

#include <algorithm>
#include <cmath>

namespace hapticlod::station {
namespace {

double norm(const double v[3]) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

bool usable(const DeviceReading& reading) {
    double length2 = 0.0;
    for (const double value : reading.pose.orientation) length2 += value * value;
    // A quaternion of length 0 has no direction; NaN fails the comparison.
    return std::isfinite(norm(reading.pose.position_mm)) && std::isfinite(reading.time_s) && length2 > 0.25 &&
           length2 < 4.0;
}

}  // namespace

const char* name_of(State state) {
    switch (state) {
        case State::idle:
            return "IDLE";
        case State::armed:
            return "ARMED";
        case State::run:
            return "RUN";
        case State::degraded:
            return "DEGRADED";
        case State::safe:
            return "SAFE";
    }
    return "?";
}

const char* name_of(SafetyFault fault) {
    switch (fault) {
        case SafetyFault::none:
            return "none";
        case SafetyFault::position_not_finite:
            return "position_not_finite";
        case SafetyFault::position_jump:
            return "position_jump";
        case SafetyFault::force_not_finite:
            return "force_not_finite";
        case SafetyFault::overruns:
            return "overruns";
    }
    return "?";
}

void SafetyCore::arm() noexcept {
    if (state_ == State::idle) state_ = State::armed;
}

void SafetyCore::trouble() noexcept {
    calm_s_ = 0.0;
    if (state_ == State::run) state_ = State::degraded;
}

void SafetyCore::stop(SafetyFault fault) noexcept {
    if (state_ == State::safe || state_ == State::idle) return;  // the first fault is the one that counts
    state_ = State::safe;
    fault_ = fault;
}

Pose SafetyCore::accept(const DeviceReading& reading) noexcept {
    if (!usable(reading)) {
        ++counts_.positions_not_finite;
        good_readings_ = 0;
        trouble();
        if (++not_finite_in_row_ > kHeldTicks) stop(SafetyFault::position_not_finite);
        return held_;
    }
    if (have_pose_) {
        double moved[3];
        for (int axis = 0; axis < 3; ++axis) {
            moved[axis] = reading.pose.position_mm[axis] - held_.position_mm[axis];
        }
        // Two readings may be off by an encoder step each, on every axis.
        const double slack_mm = 2.0 * std::sqrt(3.0) * limits_.encoder_mm;
        const double dt_s = std::max(reading.time_s - held_time_s_, limits_.period_s);
        if (!(norm(moved) - slack_mm <= limits_.max_speed_mm_s * dt_s)) {
            ++counts_.positions_rejected;
            good_readings_ = 0;
            trouble();
            if (++rejected_in_row_ >= kRejected) stop(SafetyFault::position_jump);
            return held_;
        }
    }
    not_finite_in_row_ = 0;
    rejected_in_row_ = 0;
    have_pose_ = true;
    held_ = reading.pose;
    held_time_s_ = reading.time_s;
    if (state_ == State::armed && ++good_readings_ >= kArmReadings) state_ = State::run;
    return held_;
}

bool SafetyCore::timing(double cost_us, double since_last_tick_s) noexcept {
    const bool over_budget = !(cost_us <= limits_.budget_us);
    const bool late = !(since_last_tick_s <= kLatePeriods * limits_.period_s);
    counts_.over_budget += over_budget ? 1 : 0;
    counts_.late_periods += late ? 1 : 0;
    if (!over_budget && !late) {
        overruns_in_row_ = 0;
        calm_s_ += since_last_tick_s;
        if (state_ == State::degraded && calm_s_ >= kCalm_s) state_ = State::run;
        return false;
    }
    ++overruns_in_row_;
    counts_.longest_overrun_run = std::max(counts_.longest_overrun_run, overruns_in_row_);
    trouble();
    if (overruns_in_row_ >= kOverruns) stop(SafetyFault::overruns);
    return true;
}

void SafetyCore::gate(const double wanted_n[3], double dt_s, double out_n[3]) noexcept {
    std::fill_n(out_n, 3, 0.0);
    if (live() && !std::isfinite(norm(wanted_n))) {
        ++counts_.forces_not_finite;
        stop(SafetyFault::force_not_finite);
    }
    if (!live()) {
        std::fill_n(sent_n_, 3, 0.0);
        return;
    }
    counts_.degraded_ticks += state_ == State::degraded ? 1 : 0;
    running_s_ += dt_s;
    const double ramp = limits_.engage_s > 0.0 ? std::min(1.0, running_s_ / limits_.engage_s) : 1.0;
    const double size_n = norm(wanted_n);
    const bool clamped = size_n > limits_.max_force_n;
    counts_.forces_clamped += clamped ? 1 : 0;
    const double scale = ramp * (clamped ? limits_.max_force_n / size_n : 1.0);

    double change[3];
    for (int axis = 0; axis < 3; ++axis) change[axis] = scale * wanted_n[axis] - sent_n_[axis];
    const double change_n = norm(change);
    // After a late tick the force may not catch up in one step: a device feels steps, not averages.
    const double most_n = limits_.max_slew_n_s * std::min(dt_s, limits_.period_s);
    const bool slewed = limits_.max_slew_n_s > 0.0 && change_n > most_n;
    counts_.forces_slewed += slewed ? 1 : 0;
    for (int axis = 0; axis < 3; ++axis) {
        sent_n_[axis] += change[axis] * (slewed ? most_n / change_n : 1.0);
        out_n[axis] = sent_n_[axis];
    }
}

}  // namespace hapticlod::station
