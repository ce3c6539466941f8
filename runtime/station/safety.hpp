// The safety core: everything between a device's reading and the force that is sent back, apart from the rendering.
// It trusts neither the device nor the renderer. A reviewer needs this file and safety.cpp, nothing else.
//
//     IDLE --arm()--> ARMED --good readings--> RUN <--trouble / calm--> DEGRADED
//       any of ARMED, RUN, DEGRADED --fault--> SAFE (latched: only a new core, that is a restart, leaves it)
//
//  state     force
//  IDLE      0
//  ARMED     0; the device must first deliver `kArmReadings` good readings in a row
//  RUN       rendered, limited, faded in over `engage_s`
//  DEGRADED  the same; something is being put up with, and is counted
//  SAFE      0 at once and for ever
//
//  fault                    put up with                                then
//  position not finite      last pose held for kHeldTicks (2) ticks    SAFE
//  position jump (speed)    reading rejected, pose held, 2 times       the 3rd in a row: SAFE, contact forgotten
//  force not finite         never                                      0 sent, SAFE
//  force over limit         clamped, direction kept                    -
//  force change over limit  limited, direction kept, level switches    -
//                           included
//  overrun                  coarser level first (overrun.hpp)          kOverruns (20) in a row: SAFE
//
// Rows of the fault table that need a real device (no report, unplug, frozen, watchdog) join with its driver.
#pragma once
#include <cstdint>

#include "station/device.hpp"

namespace hapticlod::station {

enum class State { idle, armed, run, degraded, safe };
enum class SafetyFault { none, position_not_finite, position_jump, force_not_finite, overruns };

[[nodiscard]] const char* name_of(State state);
[[nodiscard]] const char* name_of(SafetyFault fault);

struct SafetyLimits {
    double period_s;
    double budget_us;       // of one tick's computing
    double max_force_n;     // the smaller of device and user
    double max_slew_n_s;    // 0: none
    double max_speed_mm_s;  // beyond any hand
    double encoder_mm;      // a reading may be off by this much: it is no speed
    double engage_s;
};

struct SafetyCounts {
    std::uint64_t positions_not_finite = 0;
    std::uint64_t positions_rejected = 0;
    std::uint64_t forces_not_finite = 0;
    std::uint64_t forces_clamped = 0;
    std::uint64_t forces_slewed = 0;
    std::uint64_t over_budget = 0;   // ticks whose computing took longer than the budget
    std::uint64_t late_periods = 0;  // ticks that began more than kLatePeriods periods after the one before
    std::uint64_t longest_overrun_run = 0;
    std::uint64_t degraded_ticks = 0;
};

class SafetyCore {
public:
    static constexpr unsigned kArmReadings = 10;
    static constexpr unsigned kHeldTicks = 2;
    static constexpr unsigned kRejected = 3;
    static constexpr unsigned kOverruns = 20;
    static constexpr double kLatePeriods = 2.0;
    static constexpr double kCalm_s = 0.5;  // without trouble, until DEGRADED becomes RUN again

    explicit SafetyCore(const SafetyLimits& limits) : limits_(limits) {}

    // IDLE -> ARMED. Nothing in any other state.
    void arm() noexcept;

    // 1. Before geometry: the pose to render. Always finite; the last good one where the reading cannot be used.
    [[nodiscard]] Pose accept(const DeviceReading& reading) noexcept;

    // 2. After the tick: how long it took, and how long after the tick before it began.
    // Returns whether this tick was an overrun.
    bool timing(double cost_us, double since_last_tick_s) noexcept;

    // 3. Before sending: the force that may be sent. `dt_s` since the last call.
    void gate(const double wanted_n[3], double dt_s, double out_n[3]) noexcept;

    [[nodiscard]] State state() const { return state_; }
    [[nodiscard]] SafetyFault fault() const { return fault_; }  // why SAFE; none otherwise
    [[nodiscard]] const SafetyCounts& counts() const { return counts_; }

private:
    void trouble() noexcept;  // RUN -> DEGRADED
    void stop(SafetyFault fault) noexcept;
    [[nodiscard]] bool live() const { return state_ == State::run || state_ == State::degraded; }

    SafetyLimits limits_;
    State state_ = State::idle;
    SafetyFault fault_ = SafetyFault::none;
    SafetyCounts counts_;
    Pose held_{};
    double held_time_s_ = 0.0;
    bool have_pose_ = false;
    unsigned good_readings_ = 0;
    unsigned not_finite_in_row_ = 0;
    unsigned rejected_in_row_ = 0;
    std::uint64_t overruns_in_row_ = 0;
    double running_s_ = 0.0;
    double calm_s_ = 0.0;
    double sent_n_[3] = {0.0, 0.0, 0.0};
};

}  // namespace hapticlod::station
