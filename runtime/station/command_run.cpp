// run: the real-time loop against a device.
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>

#include "io/bundle.hpp"
#include "io/motion_csv.hpp"
#include "station/arguments.hpp"
#include "station/bundle_trust.hpp"
#include "station/commands.hpp"
#include "station/loop.hpp"
#include "station/realtime.hpp"
#include "station/run_report.hpp"
#include "station/simulated_device.hpp"
#include "station/stability.hpp"
#include "station/stop_signal.hpp"

namespace hapticlod::station {
namespace {

// The path of the simulated hand: the given motion, else the bundle's own.
Result<std::vector<MotionRow>> hand_motion(const Bundle& bundle, const std::optional<std::string>& path) {
    if (path) return read_motion_csv(*path);
    const auto golden = bundle.golden_motion();
    if (golden.empty()) return Fault{bundle.path(), "holds no golden motion", "give a motion with --motion FILE.csv"};
    return std::vector<MotionRow>(golden.begin(), golden.end());
}

// What the device cannot render is not asked of it. Says so once.
ConfigData limited(const Bundle& bundle, const DeviceTraits& device, double limit_n_mm) {
    ConfigData config = bundle.config();
    const double cap = kStiffnessShare * limit_n_mm;
    if (config.stiffness_n_mm > cap) {
        std::fprintf(stderr,
                     "%s: stiffness %.3g N/mm is rendered as %.3g N/mm, half of what device %s can hold stable at "
                     "%g Hz; use a faster loop or a device with more damping\n",
                     bundle.path().c_str(), config.stiffness_n_mm, cap, std::string(device.name).c_str(),
                     config.loop_hz);
        config.stiffness_n_mm = cap;
    }
    config.max_force_n = std::min(config.max_force_n, device.max_force_n);
    return config;
}

}  // namespace

int command_run(Words words) {
    const auto parsed = Arguments::parse(words, {{"BUNDLE"},
                                                 {"--device", "--seconds", "--motion", "--cpu", "--trusted-keys"},
                                                 {"--json", "--virtual-time", "--accept-unsigned"}});
    if (!parsed) return refuse(parsed.fault());
    const Arguments& arguments = parsed.value();
    const auto seconds = arguments.number("--seconds", 0.0, 1e-3, 1e7);
    if (!seconds) return refuse(seconds.fault());
    const auto cpu = arguments.number("--cpu", -1.0, 0.0, 1023.0);
    if (!cpu) return refuse(cpu.fault());
    const bool virtual_time = arguments.flag("--virtual-time");
    if (virtual_time && seconds.value() == 0.0) {
        return refuse({"--virtual-time", "would never end", "give --seconds too"});
    }
    const std::string device_name = arguments.option("--device").value_or("");
    if (device_name != "sim") {
        return refuse({"--device", device_name.empty() ? "is missing" : "'" + device_name + "' is not known",
                       "this version has one device: --device sim"});
    }
    const auto opened = Bundle::open(arguments.positional(0));
    if (!opened) return refuse(opened.fault());
    const Bundle& bundle = opened.value();
    const auto trust = require_trust(bundle, arguments);
    if (!trust) return refuse(trust.fault());
    auto motion = hand_motion(bundle, arguments.option("--motion"));
    if (!motion) return refuse(motion.fault());

    const double period_s = 1.0 / bundle.config().loop_hz;
    SimulatedBody body;
    body.delay_s = period_s;
    SimulatedDevice device(HandPath(std::move(motion).value()), body);
    const DeviceTraits traits = device.traits();
    const double limit_n_mm =
        stability_limit_n_mm(traits.damping_n_s_mm, bundle.config().damping_n_s_mm, period_s, traits.delay_s);
    const ConfigData config = limited(bundle, traits, limit_n_mm);
    Renderer renderer;
    if (std::string reason = renderer.load(config, bundle.levels(), bundle.tool()); !reason.empty()) {
        return refuse({bundle.path(), reason, "write the bundle again"});
    }

    RealTimeRights rights;
    if (!virtual_time) {
        const int asked = static_cast<int>(cpu.value());
        rights = acquire_real_time(asked >= 0 ? std::optional<int>(asked) : std::nullopt);
        for (const std::string& line : rights.missing) std::fprintf(stderr, "real time: %s\n", line.c_str());
    }
    SafetyCore safety({period_s, config.budget_us, config.max_force_n, config.max_slew_n_s, traits.max_speed_mm_s,
                       traits.encoder_mm, config.engage_s});
    const auto periods = static_cast<std::uint64_t>(std::llround(seconds.value() * config.loop_hz));
    const LoopSettings settings{period_s, config.budget_us,
                                seconds.value() > 0.0 ? std::max<std::uint64_t>(1, periods) : 0, config.level_count};
    const auto tally = std::make_unique<Tally>();
    MonotonicClock monotonic;
    VirtualClock simulated;
    LoopClock& clock = virtual_time ? static_cast<LoopClock&>(simulated) : monotonic;
    const std::atomic<bool>& stop = stop_signal();
    safety.arm();
    const LoopOutcome outcome = run_loop(renderer, device, safety, clock, settings, stop, *tally);

    const RunReport report{bundle.path(),  trust.value(),   arguments.option("--motion").value_or("golden motion"),
                           traits,         config,          bundle.config().stiffness_n_mm,
                           limit_n_mm,     virtual_time,    stop.load(),
                           rights,         outcome,         safety.state(),
                           safety.fault(), safety.counts(), *tally};
    if (!arguments.flag("--json")) std::fputs(report_text(report).c_str(), stdout);
    std::puts(report_json(report).c_str());
    return safety.state() == State::safe ? kExitFault : kExitFine;
}

}  // namespace hapticlod::station
