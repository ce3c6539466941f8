#include "station/open_device.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>

#include "io/motion_csv.hpp"
#include "station/profile_folder.hpp"
#include "station/simulated_device.hpp"
#include "station/stability.hpp"

namespace hapticlod::station {
namespace {

Result<std::vector<MotionRow>> hand_motion(const Bundle& bundle, const std::optional<std::string>& path) {
    if (path) return read_motion_csv(*path);
    const auto golden = bundle.golden_motion();
    if (golden.empty()) return Fault{bundle.path(), "holds no golden motion", "give a motion with --motion FILE.csv"};
    return std::vector<MotionRow>(golden.begin(), golden.end());
}

// "1.5,-2,30"
std::optional<std::array<double, 3>> three_numbers(const std::string& text) {
    std::array<double, 3> values{};
    const char *at = text.data(), *end = text.data() + text.size();
    for (std::size_t i = 0; i < 3; ++i) {
        const auto [stop, error] = std::from_chars(at, end, values[i]);
        if (error != std::errc() || !std::isfinite(values[i])) return std::nullopt;
        if (i < 2 ? stop == end || *stop != ',' : stop != end) return std::nullopt;
        at = stop + 1;
    }
    return values;
}

}  // namespace

Result<DeviceChoice> choose_device(const Arguments& arguments, const Bundle& bundle) {
    const auto name = arguments.option("--device");
    if (!name) return Fault{"--device", "is missing", "give sim, a profile's name, or a profile's TOML file"};
    auto profile = find_profile(*name);
    if (!profile) return profile.fault();
    const double* origin = bundle.config().origin_mm;
    DeviceChoice choice{std::move(profile).value(),
                        arguments.option("--path").value_or(""),
                        arguments.option("--serial").value_or(""),
                        {origin[0], origin[1], origin[2]},
                        arguments.flag("--accept-no-watchdog")};
    if (const auto text = arguments.option("--centre-mm")) {
        const auto centre = three_numbers(*text);
        if (!centre) return Fault{"--centre-mm", "is '" + *text + "'", "give a point of the scan as X,Y,Z in mm"};
        choice.centre_mm = *centre;
    }
    const DeviceProfile& read = choice.profile;
    if (!read.simulated && read.output && read.timing.watchdog_ms == 0.0 && !choice.accept_no_watchdog) {
        return Fault{read.file, "this device has no watchdog: its motors keep the last force if this program dies",
                     "have a switch within reach that cuts its power, and give --accept-no-watchdog"};
    }
    return choice;
}

Result<OpenDevice> open_device(const DeviceChoice& choice, const Bundle& bundle,
                               const std::optional<std::string>& motion) {
    const double period_s = 1.0 / bundle.config().loop_hz, damping = bundle.config().damping_n_s_mm;
    OpenDevice opened;
    if (choice.profile.simulated) {
        auto rows = hand_motion(bundle, motion);
        if (!rows) return rows.fault();
        SimulatedBody body = *choice.profile.simulated;
        body.delay_s = std::max(body.delay_s, period_s);  // a force is felt in the next period at the earliest
        if (choice.profile.file == "sim") body.delay_s = period_s;
        opened.device = std::make_unique<SimulatedDevice>(HandPath(std::move(rows).value()), body);
        const DeviceTraits traits = opened.device->traits();
        opened.stability_limit_n_mm = stability_limit_n_mm(traits.damping_n_s_mm, damping, period_s, traits.delay_s);
        return opened;
    }
    if (motion) return Fault{"--motion", "is for the simulated hand", "leave it out: this device has a hand"};
    const auto entry = find_device(choice.profile, choice.path, choice.serial);
    if (!entry) return entry.fault();
    auto device = HidDevice::open(choice.profile, entry.value(), choice.centre_mm);
    if (!device) return device.fault();
    opened.hid = device.value().get();
    opened.device = std::move(device).value();
    opened.stability_limit_n_mm = choice.profile.stability_limit_n_mm(damping, period_s);
    return opened;
}

ConfigData limited_config(const Bundle& bundle, const OpenDevice& opened) {
    ConfigData config = bundle.config();
    const DeviceTraits device = opened.device->traits();
    const double cap = kStiffnessShare * opened.stability_limit_n_mm;
    if (config.stiffness_n_mm > cap) {
        std::fprintf(stderr,
                     "%s: stiffness %.3g N/mm is rendered as %.3g N/mm, half of what device %s can hold stable at "
                     "%g Hz; use a faster loop or a device with more damping\n",
                     bundle.path().c_str(), config.stiffness_n_mm, cap, std::string(device.name).c_str(),
                     config.loop_hz);
        config.stiffness_n_mm = cap;
    }
    if (device.max_force_n > 0.0) config.max_force_n = std::min(config.max_force_n, device.max_force_n);
    if (device.max_slew_n_s > 0.0) {
        config.max_slew_n_s =
            config.max_slew_n_s > 0.0 ? std::min(config.max_slew_n_s, device.max_slew_n_s) : device.max_slew_n_s;
    }
    return config;
}

}  // namespace hapticlod::station
