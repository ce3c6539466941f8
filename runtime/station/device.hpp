// What the loop needs of a force-feedback device: the newest pose in, a force out, and what happened on the way.
#pragma once
#include <cstdint>
#include <string_view>

#include "core/renderer.hpp"

namespace hapticlod::station {

// What the driver saw since the last reading. The safety core judges it; the driver only reports.
struct LinkReport {
    bool fresh = true;          // at least one report arrived
    bool gone = false;          // reading or writing said that the device is no longer there
    bool wrong_report = false;  // a report that the profile does not know, or with a wrong checksum
    std::uint32_t drained = 1;  // reports that had queued up; the newest was kept
    std::uint32_t lost = 0;     // sequence numbers that never came
    std::uint32_t repeats = 0;  // reports in a row with one and the same sequence number (or device time)
    double writing_s = 0.0;     // how long the write that is under way has been under way
    bool device_fault = false;  // status bits
    bool estop = false;
    bool watchdog_tripped = false;
    bool calibrated = true;
    std::uint32_t status = 0, buttons = 0;  // raw
};

struct DeviceReading {
    Pose pose;      // scan frame; of the newest report
    double time_s;  // the device's clock
    LinkReport link{};
};

struct DeviceTraits {
    std::string_view name;
    double max_force_n;
    double max_speed_mm_s;        // faster than any hand moves it: a reading beyond is a fault
    double encoder_mm;            // position resolution
    double damping_n_s_mm;        // its own, physical
    double delay_s;               // from a position to the force it causes being felt, beyond half a period
    double max_slew_n_s = 0.0;    // 0: no limit
    double first_report_s = 0.5;  // after opening
};

class Device {
public:
    virtual ~Device() = default;
    [[nodiscard]] virtual DeviceTraits traits() const noexcept = 0;
    // `now_ns` is the loop's clock. Called from the loop: no allocation, no waiting.
    virtual DeviceReading read(std::int64_t now_ns) noexcept = 0;
    // `enabled`: the safety core lets a force through; a device that can be told is told.
    virtual void write(std::int64_t now_ns, const double force_n[3], bool enabled) noexcept = 0;
};

}  // namespace hapticlod::station
