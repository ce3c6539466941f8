// What is known about one kind of device: a TOML file (docs/devices.md). The same rules as hapticlod/device_profile.py;
// tests/test_device_profile.py gives both the same wrong files.
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "io/result.hpp"
#include "station/kinematics.hpp"
#include "station/report_layout.hpp"
#include "station/simulated_device.hpp"

namespace hapticlod::station {

// Which HID devices it is for. Empty or absent: any.
struct DeviceMatch {
    std::uint16_t vendor_id = 0, product_id = 0;
    std::optional<std::uint16_t> usage_page, usage;
    std::string product;  // part of the product string
    std::string serial;   // the whole serial number
};

// Masks of the status field; 0: the device does not say.
struct StatusBits {
    std::uint32_t motors = 0, fault = 0, estop = 0, watchdog = 0, calibrated = 0;
};

struct DeviceLimits {
    double max_force_n = 0.0;
    double max_force_rate_n_ms = 0.0;
    double max_speed_mm_s = 0.0;      // faster than any hand moves it: a reading beyond is a fault
    double resolution_mm = 0.0;       // of a position
    double damping_n_s_mm = 0.0;      // its own, physical; 0: not known
    double max_stiffness_n_mm = 0.0;  // as its maker states it; 0: not stated
};

struct DeviceTiming {
    double rate_hz = 1000.0;       // of its reports
    double delay_ms = 0.0;         // from a written force to its being felt, beyond the loop's own
    double first_report_ms = 500;  // after opening
    double watchdog_ms = 0.0;      // its firmware lets go after this long without a report; 0: it has none
    bool host_first = false;       // sends nothing until it was written to
};

struct DeviceProfile {
    std::string file;  // where it was read from
    std::string name;
    std::string status;  // what it was tried on
    DeviceMatch match;
    std::vector<ReportLayout> inputs;
    StatusBits status_bits;
    std::optional<ReportLayout> output;  // none: an input device
    Kinematics kinematics;
    DeviceLimits limits;
    DeviceTiming timing;
    std::optional<SimulatedBody> simulated;  // then there is no hardware, and the rest is not used

    // Largest stable stiffness at a loop period, N/mm (stability.hpp); +inf for a device without motors.
    [[nodiscard]] double stability_limit_n_mm(double rendered_damping_n_s_mm, double period_s) const;
};

[[nodiscard]] Result<DeviceProfile> read_device_profile(const std::string& path);
[[nodiscard]] Result<DeviceProfile> parse_device_profile(std::string_view toml, const std::string& name);

}  // namespace hapticlod::station
