// The safety core: everything between a device's reading and the force that is sent back, apart from the rendering.
// It trusts neither the device nor the renderer. A reviewer needs this file and safety.cpp, nothing else;
// docs/safety.md says what it is not.
//
//     IDLE --arm()--> ARMED --good readings--> RUN <--trouble / calm--> DEGRADED
//       any of ARMED, RUN, DEGRADED --fault--> SAFE (latched: only a new core leaves it, and an operator asks for one)
//
//  state     force
//  IDLE      0
//  ARMED     0, until `kArmReadings` good readings came in a row, of a device that is calibrated and not let go
//  RUN       rendered, limited, faded in over `engage_s`
//  DEGRADED  the same; something is being put up with, and is counted
//  SAFE      0 at once and for ever
//
//  fault                    put up with                                            then
//  ------------------------------------------------------------------------------------------------------------
//  no report                kSilent_s (5 ms); then fades, 0 after kCut_s (10 ms)   SAFE after kDead_s (20 ms)
//  frozen device            kFrozen (10) reports of one sequence number            SAFE
//  lost reports             more than kLostShare (5 %) in a second: DEGRADED       -
//  backlog                  newest report only; the slew limit takes the step      -
//  unplugged                never                                                  SAFE
//  wrong report, checksum   never                                                  SAFE
//  position not finite      last pose held for kHeldTicks (2) ticks                SAFE
//  position jump (speed)    reading rejected, pose held, 2 times                   the 3rd in a row: SAFE
//  force not finite         never                                                  0 sent, SAFE
//  force over limit         clamped, direction kept                                -
//  force change over limit  limited, direction kept, level switches included       -
//  tick over budget         coarser level first (overrun.hpp), DEGRADED            kOverruns (20) in a row: SAFE
//  late period              DEGRADED; the phase is kept                            kOverruns (20) in a row: SAFE
//  write blocked            kStuck_s (20 ms)                                       SAFE; the firmware lets go
//  device fault, e-stop,    never                                                  SAFE
//    its watchdog let go
//  operator's stop          never                                                  SAFE
//
//  Outside this file: a device of other ids, usage or report, another program's, or without a watchdog is not armed
//  (hid_connection.cpp, open_device.cpp); a damaged bundle is not loaded (io/bundle.cpp); of a program that was killed
//  nothing is left but the firmware's watchdog.
//
// A device slower than 600 reports a second is granted 3, 6 and 12 of its periods for the times of `no report`, and 12
// for a write.
#pragma once
#include <cstdint>

#include "station/device.hpp"

namespace hapticlod::station {

enum class State : std::uint8_t { idle, armed, run, degraded, safe };
enum class SafetyFault : std::uint8_t {
    none,
    position_not_finite,
    position_jump,
    force_not_finite,
    overruns,
    no_report,
    frozen,
    unplugged,
    wrong_report,
    write_blocked,
    device_fault,
    device_estop,
    device_watchdog,
    operator_stop
};

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
    double report_period_s = 0.0;           // of the device
    double first_report_s = 0.5;            // how long a device may be silent while ARMED
    bool motors = true;                     // false: an input device; its silence harms nobody
    double passivity_damping_n_s_mm = 0.0;  // most damping the passivity controller may add; 0: it only observes
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
    std::uint64_t reports_lost = 0;
    std::uint64_t backlogs = 0;         // readings that found more than kBacklog reports
    std::uint64_t silences = 0;         // times that no report came for kSilent_s
    std::uint64_t uncalibrated = 0;     // readings while ARMED of a device that was not ready
    std::uint64_t passivity_ticks = 0;  // in which the controller added damping
    double longest_silence_s = 0.0;
    double most_energy_out_mj = 0.0;  // passivity observer: most work done on the hand within one contact
};

class SafetyCore {
public:
    static constexpr unsigned kArmReadings = 10;
    static constexpr unsigned kHeldTicks = 2;
    static constexpr unsigned kRejected = 3;
    static constexpr unsigned kOverruns = 20;
    static constexpr unsigned kFrozen = 10;
    static constexpr unsigned kBacklog = 3;
    static constexpr double kSilent_s = 0.005, kCut_s = 0.010, kDead_s = 0.020;
    static constexpr double kStuck_s = 0.020;
    static constexpr double kLostShare = 0.05;
    static constexpr double kLatePeriods = 2.0;
    static constexpr double kCalm_s = 0.5;  // without trouble, until DEGRADED becomes RUN again

    explicit SafetyCore(const SafetyLimits& limits) : limits_(limits) {}

    // IDLE -> ARMED. Nothing in any other state.
    void arm() noexcept;

    // The operator's stop: SAFE.
    void emergency_stop() noexcept { stop(SafetyFault::operator_stop); }

    // 1. What the driver saw, every tick. `dt_s` since the last tick.
    void link(const LinkReport& seen, double dt_s) noexcept;

    // 2. Before geometry, when a report came: the pose to render. Always finite; the last good one where the reading
    // cannot be used.
    [[nodiscard]] Pose accept(const DeviceReading& reading) noexcept;

    // 3. After the tick: how long it took, and how long after the tick before it began.
    // Returns whether this tick was an overrun.
    bool timing(double cost_us, double since_last_tick_s) noexcept;

    // 4. Before sending: the force that may be sent. `dt_s` since the last call.
    void gate(const double wanted_n[3], double dt_s, double out_n[3]) noexcept;

    [[nodiscard]] State state() const { return state_; }
    [[nodiscard]] SafetyFault fault() const { return fault_; }  // why SAFE; none otherwise
    // Whether a force may come out of gate(): RUN and DEGRADED.
    [[nodiscard]] bool live() const { return state_ == State::run || state_ == State::degraded; }
    [[nodiscard]] const SafetyCounts& counts() const { return counts_; }
    // Work done on the hand since this contact began, mJ; above 0 the loop gave energy that it was never given.
    [[nodiscard]] double energy_out_mj() const { return energy_out_mj_; }

private:
    void trouble() noexcept;  // RUN -> DEGRADED
    void stop(SafetyFault fault) noexcept;
    void silence(double dt_s) noexcept;
    void losses(const LinkReport& seen, double dt_s) noexcept;
    void passivity(double dt_s, double force_n[3]) noexcept;
    [[nodiscard]] double patience() const;  // factor on the times of `no report`

    SafetyLimits limits_;
    State state_ = State::idle;
    SafetyFault fault_ = SafetyFault::none;
    SafetyCounts counts_;
    Pose held_{};
    double held_time_s_ = 0.0;
    double since_good_s_ = 0.0;  // by the loop's clock
    bool have_pose_ = false;
    bool ready_ = true;  // the device says it is calibrated and not let go by its watchdog
    unsigned good_readings_ = 0;
    unsigned not_finite_in_row_ = 0;
    unsigned rejected_in_row_ = 0;
    std::uint64_t overruns_in_row_ = 0;
    double silent_s_ = 0.0;
    double armed_s_ = 0.0;
    double lost_ = 0.0, received_ = 0.0;  // both forget within a second
    double running_s_ = 0.0;
    double calm_s_ = 0.0;
    double sent_n_[3] = {0.0, 0.0, 0.0};
    double sent_at_mm_[3] = {0.0, 0.0, 0.0};  // where the device was then
    double energy_out_mj_ = 0.0;
};

}  // namespace hapticlod::station
