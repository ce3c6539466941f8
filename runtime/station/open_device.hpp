// From the words of the command line to a device that is open, and to limits that it can keep.
#pragma once
#include <memory>
#include <string>

#include "io/bundle.hpp"
#include "station/arguments.hpp"
#include "station/device_profile.hpp"
#include "station/hid_device.hpp"

namespace hapticlod::station {

struct DeviceChoice {
    DeviceProfile profile;
    std::string path, serial;  // empty: any
    std::array<double, 3> centre_mm;
    bool accept_no_watchdog = false;
};

struct OpenDevice {
    std::unique_ptr<Device> device;
    HidDevice* hid = nullptr;  // the same, where it is one
    double stability_limit_n_mm = 0.0;
};

// Reads the profile that --device names. Refuses one whose firmware has no watchdog unless that was accepted.
[[nodiscard]] Result<DeviceChoice> choose_device(const Arguments& arguments, const Bundle& bundle);
// `motion` is the simulated hand's: the given file, else the bundle's own; not read for hardware.
[[nodiscard]] Result<OpenDevice> open_device(const DeviceChoice& choice, const Bundle& bundle,
                                             const std::optional<std::string>& motion);
// The bundle's config, with what the device cannot render not asked of it. Says so once.
[[nodiscard]] ConfigData limited_config(const Bundle& bundle, const OpenDevice& opened);

}  // namespace hapticlod::station
