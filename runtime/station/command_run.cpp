// run: the real-time loop against a device.
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>
#include <thread>

#include "io/bundle.hpp"
#include "station/bundle_trust.hpp"
#include "station/commands.hpp"
#include "station/loop.hpp"
#include "station/open_device.hpp"
#include "station/realtime.hpp"
#include "station/recorder.hpp"
#include "station/run_report.hpp"
#include "station/stop_signal.hpp"

namespace hapticlod::station {
namespace {

constexpr double kRingSeconds = kFlightSeconds + 0.5;
constexpr double kMostRecordedSeconds = 600.0;  // in simulated time, which no recorder can follow

template <std::size_t N>
void copy_text(char (&out)[N], std::string_view text) {
    std::memcpy(out, text.data(), std::min(text.size(), N - 1));
}

TelemetrySource source_of(const Bundle& bundle, const DeviceTraits& device, std::int64_t now_ns) {
    TelemetrySource source{};
    const ConfigData& config = bundle.config();
    source.pid = static_cast<std::uint32_t>(::getpid());
    source.level_count = config.level_count;
    std::copy_n(config.triangles, kMaxLevels, source.triangles);
    source.loop_hz = config.loop_hz;
    source.budget_us = config.budget_us;
    source.start_ns = now_ns;
    source.start_unix_ns = std::chrono::system_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
    copy_text(source.bundle, bundle.path());
    copy_text(source.device, device.name);
    return source;
}

SafetyLimits safety_limits(const ConfigData& config, const DeviceProfile& profile, const DeviceTraits& traits,
                           double passivity_damping_n_s_mm) {
    const bool hardware = !profile.simulated;
    return {1.0 / config.loop_hz,    config.budget_us,
            config.max_force_n,      config.max_slew_n_s,
            traits.max_speed_mm_s,   traits.encoder_mm,
            config.engage_s,         hardware ? 1.0 / profile.timing.rate_hz : 0.0,
            traits.first_report_s,   !hardware || profile.output.has_value(),
            passivity_damping_n_s_mm};
}

// A device that went away and can come back by itself, or by a hand.
bool may_return(SafetyFault fault) {
    return fault == SafetyFault::unplugged || fault == SafetyFault::no_report || fault == SafetyFault::write_blocked ||
           fault == SafetyFault::frozen;
}

// Waits until the same device is there and can be opened again. False when told to stop.
bool wait_for_device(DeviceChoice& choice, const HidEntry& was, const Bundle& bundle, OpenDevice& opened,
                     const std::atomic<bool>& stop) {
    choice.serial = was.serial;
    if (was.serial.empty()) choice.path = was.path;
    std::fprintf(stderr, "%s: gone; waiting for it to come back (Ctrl-C ends)\n", was.path.c_str());
    while (!stop.load()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
        auto again = open_device(choice, bundle, std::nullopt);
        if (!again) continue;
        opened = std::move(again).value();
        std::fprintf(stderr, "%s: back\n", opened.hid->entry().path.c_str());
        return true;
    }
    return false;
}

// The operator's word that the device may be armed again. What was typed before it was asked for does not count.
bool confirmed(const std::atomic<bool>& stop) {
    char key = 0;
    for (pollfd input{STDIN_FILENO, POLLIN, 0}; ::poll(&input, 1, 0) > 0;) {
        if (::read(STDIN_FILENO, &key, 1) != 1) break;
    }
    std::fprintf(stderr, "clear the device, then press Enter to arm it again (Ctrl-C ends)\n");
    while (!stop.load()) {
        const ssize_t got = ::read(STDIN_FILENO, &key, 1);
        if (got == 0) std::fprintf(stderr, "standard input has ended: nobody can arm the device\n");
        if (got != 1) return false;
        if (key == '\n') return true;
    }
    return false;
}

}  // namespace

int command_run(Words words) {
    const auto parsed = Arguments::parse(
        words,
        {{"BUNDLE"},
         {"--device", "--path", "--serial", "--centre-mm", "--seconds", "--motion", "--cpu", "--record", "--flight",
          "--passivity-damping", "--trusted-keys", "--control"},
         {"--json", "--virtual-time", "--accept-no-watchdog", "--reconnect", "--accept-unsigned", "--check-all"}});
    if (!parsed) return refuse(parsed.fault());
    const Arguments& arguments = parsed.value();
    const auto seconds = arguments.number("--seconds", 0.0, 1e-3, 1e7);
    if (!seconds) return refuse(seconds.fault());
    const auto cpu = arguments.number("--cpu", -1.0, 0.0, 1023.0);
    if (!cpu) return refuse(cpu.fault());
    const auto passivity = arguments.number("--passivity-damping", 0.0, 0.0, 1.0);
    if (!passivity) return refuse(passivity.fault());
    const bool virtual_time = arguments.flag("--virtual-time");
    if (virtual_time && seconds.value() == 0.0) {
        return refuse({"--virtual-time", "would never end", "give --seconds too"});
    }
    CheckedFiles known(arguments.flag("--check-all") ? std::string{} : CheckedFiles::standard_path());
    const auto bundle_opened = Bundle::open(arguments.positional(0), known);
    if (!bundle_opened) return refuse(bundle_opened.fault());
    const Bundle& bundle = bundle_opened.value();
    const auto trust = require_trust(bundle, arguments);
    if (!trust) return refuse(trust.fault());
    auto chosen = choose_device(arguments, bundle);
    if (!chosen) return refuse(chosen.fault());
    DeviceChoice& choice = chosen.value();
    if (virtual_time && !choice.profile.simulated) {
        return refuse({"--virtual-time", "is for the simulated device", "leave it out"});
    }
    auto device_opened = open_device(choice, bundle, arguments.option("--motion"));
    if (!device_opened) return refuse(device_opened.fault());
    OpenDevice& opened = device_opened.value();
    const double stability_limit_n_mm = opened.stability_limit_n_mm;
    const DeviceTraits traits = opened.device->traits();
    const ConfigData config = limited_config(bundle, opened);
    Renderer renderer;
    if (std::string reason = bundle.prepare(renderer, config); !reason.empty()) {
        return refuse({bundle.path(), reason, "write the bundle again"});
    }

    std::unique_ptr<SceneControl> control;
    if (const auto pipe = arguments.option("--control")) {
        auto started = SceneControl::start(*pipe, bundle, renderer, [&arguments](const Bundle& other) {
            const auto believed = require_trust(other, arguments);
            return believed ? std::string() : believed.fault().line();
        });
        if (!started) return refuse(started.fault());
        control = std::move(started).value();
    }

    MonotonicClock monotonic;
    VirtualClock simulated;
    LoopClock& clock = virtual_time ? static_cast<LoopClock&>(simulated) : monotonic;
    const double ring_s = virtual_time ? std::clamp(seconds.value(), kRingSeconds, kMostRecordedSeconds) : kRingSeconds;
    auto telemetry = TelemetryRing::create(source_of(bundle, traits, clock.now_ns()), ring_s);
    if (!telemetry) return refuse(telemetry.fault());
    std::unique_ptr<Recorder> recorder;
    if (const auto path = arguments.option("--record")) {
        auto started = Recorder::start(*path, telemetry.value());
        if (!started) return refuse(started.fault());
        recorder = std::move(started).value();
    }

    const std::atomic<bool>& stop = stop_signal();
    std::atomic<bool>& emergency = emergency_signal();
    const auto periods = static_cast<std::uint64_t>(std::llround(seconds.value() * config.loop_hz));
    LoopSettings settings{
        1.0 / config.loop_hz, config.budget_us, seconds.value() > 0.0 ? std::max<std::uint64_t>(1, periods) : 0,
        config.level_count,   &emergency,       &telemetry.value(),
        control.get()};
    const SafetyLimits limits = safety_limits(config, choice.profile, traits, passivity.value());
    const auto tally = std::make_unique<Tally>();
    RealTimeRights rights;
    std::unique_ptr<SafetyCore> safety;
    LoopOutcome outcome;
    std::string flight;
    for (;;) {
        safety = std::make_unique<SafetyCore>(limits);
        {
            const EmergencyKey key;
            if (!virtual_time && rights.missing.empty() && !rights.fifo) {
                // After every other thread was started: only this one may be pinned.
                const int asked = static_cast<int>(cpu.value());
                rights = acquire_real_time(asked >= 0 ? std::optional<int>(asked) : std::nullopt);
                for (const std::string& line : rights.missing) std::fprintf(stderr, "real time: %s\n", line.c_str());
            }
            safety->arm();
            outcome = run_loop(renderer, *opened.device, *safety, clock, settings, stop, *tally);
        }
        if (opened.hid != nullptr) opened.hid->flush(0.1);
        if (safety->state() != State::safe) break;
        const auto written =
            write_flight_recording(telemetry.value(), arguments.option("--flight").value_or(flight_folder()));
        if (written) {
            flight = written.value();
            std::fprintf(stderr, "SAFE (%s): the last seconds are in %s\n", name_of(safety->fault()), flight.c_str());
        } else {
            std::fprintf(stderr, "%s\n", written.fault().line().c_str());
        }
        if (!arguments.flag("--reconnect") || opened.hid == nullptr || !may_return(safety->fault())) break;
        const HidEntry was = opened.hid->entry();
        opened = {};
        if (!wait_for_device(choice, was, bundle, opened, stop) || !confirmed(stop)) break;
    }

    const RunReport report{bundle.path(),
                           trust.value(),
                           bundle.checked_before(),
                           arguments.option("--motion").value_or(choice.profile.simulated ? "golden motion" : "hand"),
                           traits,
                           config,
                           bundle.config().stiffness_n_mm,
                           stability_limit_n_mm,
                           virtual_time,
                           stop.load(),
                           rights,
                           outcome,
                           safety->state(),
                           safety->fault(),
                           safety->counts(),
                           *tally,
                           opened.hid != nullptr ? &opened.hid->round_trip() : nullptr,
                           flight};
    int status = safety->state() == State::safe ? kExitFault : kExitFine;
    if (recorder != nullptr) {
        if (const auto fault = recorder->stop()) status = refuse(*fault);
        if (recorder->missed() > 0) {
            std::fprintf(stderr, "%s: %llu of its ticks could not be followed; record to a faster disk\n",
                         arguments.option("--record")->c_str(), static_cast<unsigned long long>(recorder->missed()));
        }
    }
    if (!arguments.flag("--json")) std::fputs(report_text(report).c_str(), stdout);
    std::puts(report_json(report).c_str());
    return status;
}

}  // namespace hapticlod::station
