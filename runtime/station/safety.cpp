#include "station/safety.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>

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
    constexpr const char* kNames[] = {"IDLE", "ARMED", "RUN", "DEGRADED", "SAFE"};
    const auto index = static_cast<std::size_t>(state);
    return index < std::size(kNames) ? kNames[index] : "?";
}

const char* name_of(SafetyFault fault) {
    constexpr const char* kNames[] = {"none",
                                      "position_not_finite",
                                      "position_jump",
                                      "force_not_finite",
                                      "overruns",
                                      "no_report",
                                      "frozen",
                                      "unplugged",
                                      "wrong_report",
                                      "write_blocked",
                                      "device_fault",
                                      "device_estop",
                                      "device_watchdog",
                                      "operator_stop"};
    const auto index = static_cast<std::size_t>(fault);
    return index < std::size(kNames) ? kNames[index] : "?";
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

double SafetyCore::patience() const { return std::max(1.0, 3.0 * limits_.report_period_s / kSilent_s); }

// 1. The link.
void SafetyCore::link(const LinkReport& seen, double dt_s) noexcept {
    since_good_s_ += dt_s;
    if (seen.gone) stop(SafetyFault::unplugged);
    if (seen.wrong_report) stop(SafetyFault::wrong_report);
    if (seen.device_fault) stop(SafetyFault::device_fault);
    if (seen.estop) stop(SafetyFault::device_estop);
    if (seen.writing_s > patience() * kStuck_s) stop(SafetyFault::write_blocked);
    if (seen.repeats >= kFrozen) stop(SafetyFault::frozen);
    if (live() && seen.watchdog_tripped) stop(SafetyFault::device_watchdog);
    if (live() && !seen.calibrated) stop(SafetyFault::device_fault);
    ready_ = seen.calibrated && !seen.watchdog_tripped;
    losses(seen, dt_s);
    if (seen.fresh) {
        silent_s_ = 0.0;
    } else {
        silence(dt_s);
    }
}

void SafetyCore::silence(double dt_s) noexcept {
    if (!limits_.motors) return;
    if (!have_pose_) {  // ARMED, and it has not spoken yet
        armed_s_ += dt_s;
        if (armed_s_ > limits_.first_report_s) stop(SafetyFault::no_report);
        return;
    }
    const bool before = silent_s_ > patience() * kSilent_s;
    silent_s_ += dt_s;
    counts_.longest_silence_s = std::max(counts_.longest_silence_s, silent_s_);
    if (silent_s_ <= patience() * kSilent_s) return;
    counts_.silences += before ? 0 : 1;
    good_readings_ = 0;
    trouble();
    if (silent_s_ >= patience() * kDead_s) stop(SafetyFault::no_report);
}

void SafetyCore::losses(const LinkReport& seen, double dt_s) noexcept {
    counts_.reports_lost += seen.lost;
    counts_.backlogs += seen.drained > kBacklog ? 1 : 0;
    const double kept = std::exp(-dt_s);  // a second's memory
    lost_ = kept * lost_ + seen.lost;
    received_ = kept * received_ + (seen.fresh ? seen.drained : 0);
    const double all = lost_ + received_;
    if (all > 20.0 && lost_ > kLostShare * all) trouble();  // of fewer reports a share says nothing
}

// 2. The position.
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
        // By the device's clock, but not much longer than by ours: its clock may be what is wrong.
        const double longest_s = std::max(limits_.period_s, since_good_s_ + patience() * kDead_s);
        const double dt_s = std::clamp(reading.time_s - held_time_s_, limits_.period_s, longest_s);
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
    since_good_s_ = 0.0;
    if (state_ == State::armed && !ready_) {
        ++counts_.uncalibrated;
        good_readings_ = 0;
    } else if (state_ == State::armed && ++good_readings_ >= kArmReadings) {
        state_ = State::run;
    }
    return held_;
}

// 3. The time.
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

// 4. The force.
void SafetyCore::gate(const double wanted_n[3], double dt_s, double out_n[3]) noexcept {
    std::fill_n(out_n, 3, 0.0);
    if (live() && !std::isfinite(norm(wanted_n))) {
        ++counts_.forces_not_finite;
        stop(SafetyFault::force_not_finite);
    }
    if (!live()) {
        std::fill_n(sent_n_, 3, 0.0);
        energy_out_mj_ = 0.0;
        return;
    }
    counts_.degraded_ticks += state_ == State::degraded ? 1 : 0;
    running_s_ += dt_s;
    const double ramp = limits_.engage_s > 0.0 ? std::min(1.0, running_s_ / limits_.engage_s) : 1.0;
    double force_n[3] = {ramp * wanted_n[0], ramp * wanted_n[1], ramp * wanted_n[2]};
    passivity(dt_s, force_n);

    const double size_n = norm(force_n);
    if (size_n > limits_.max_force_n) {
        ++counts_.forces_clamped;
        for (double& value : force_n) value *= limits_.max_force_n / size_n;
    }
    double change[3];
    for (int axis = 0; axis < 3; ++axis) change[axis] = force_n[axis] - sent_n_[axis];
    const double change_n = norm(change);
    // After a late tick the force may not catch up in one step: a device feels steps, not averages.
    const double most_n = limits_.max_slew_n_s * std::min(dt_s, limits_.period_s);
    const bool slewed = limits_.max_slew_n_s > 0.0 && change_n > most_n;
    counts_.forces_slewed += slewed ? 1 : 0;
    // Without reports the force goes to 0 by the clock; no other limit may hold it up.
    const double silent = silent_s_ / patience();
    const double fade = std::clamp((kCut_s - silent) / (kCut_s - kSilent_s), 0.0, 1.0);
    for (int axis = 0; axis < 3; ++axis) {
        sent_n_[axis] = fade * (sent_n_[axis] + change[axis] * (slewed ? most_n / change_n : 1.0));
        out_n[axis] = sent_n_[axis];
    }
}

// Observer: the work of the force that was held since the last tick. Controller, where asked for: damping that takes
// back, within one tick, what was given too much (Hannaford and Ryu 2002).
void SafetyCore::passivity(double dt_s, double force_n[3]) noexcept {
    double moved[3];
    for (int axis = 0; axis < 3; ++axis) {
        moved[axis] = held_.position_mm[axis] - sent_at_mm_[axis];
        energy_out_mj_ += sent_n_[axis] * moved[axis];
        sent_at_mm_[axis] = held_.position_mm[axis];
    }
    if (norm(sent_n_) == 0.0 && norm(force_n) == 0.0) energy_out_mj_ = 0.0;  // each contact has its own account
    counts_.most_energy_out_mj = std::max(counts_.most_energy_out_mj, energy_out_mj_);
    const double moved_mm = norm(moved);
    if (limits_.passivity_damping_n_s_mm <= 0.0 || energy_out_mj_ <= 0.0 || moved_mm == 0.0 || dt_s <= 0.0) return;
    // Damping b along this tick's way takes b |moved|^2 / dt.
    const double damping = std::min(limits_.passivity_damping_n_s_mm, energy_out_mj_ * dt_s / (moved_mm * moved_mm));
    ++counts_.passivity_ticks;
    for (int axis = 0; axis < 3; ++axis) force_n[axis] -= damping * moved[axis] / dt_s;
}

}  // namespace hapticlod::station
