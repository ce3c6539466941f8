// qualify: does this machine render this bundle as the machine that made it, and in time? A certificate, pass or fail.
#include <sys/utsname.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <memory>
#include <vector>

#include "core/renderer.hpp"
#include "io/atomic_file.hpp"
#include "io/bundle.hpp"
#include "io/digest.hpp"
#include "io/json_text.hpp"
#include "station/arguments.hpp"
#include "station/bundle_trust.hpp"
#include "station/clock.hpp"
#include "station/commands.hpp"
#include "station/histogram.hpp"
#include "station/realtime.hpp"

namespace hapticlod::station {
namespace {

constexpr int kRounds = 3;

struct Qualification {
    std::uint64_t ticks = 0, forces_off = 0, levels_off = 0, contacts_off = 0;
    double worst_force_n = 0.0;  // largest difference to the golden record
    std::uint64_t worst_tick = 0;
    double budget_us = 0.0, tolerance_n = 0.0;
    std::unique_ptr<Histogram> cost = std::make_unique<Histogram>();

    [[nodiscard]] bool forces_equal() const { return forces_off == 0 && levels_off == 0 && contacts_off == 0; }
    [[nodiscard]] bool in_time() const { return cost->percentile_us(0.999) <= budget_us; }
};

void compare(const TickRecord& got, const TickRecord& golden, std::uint64_t tick, Qualification& result) {
    double difference = 0.0;
    for (int axis = 0; axis < 3; ++axis) {
        difference = std::max(difference, std::abs(got.force_n[axis] - golden.force_n[axis]));
    }
    if (!(difference <= result.worst_force_n)) {  // NaN, too
        result.worst_force_n = difference;
        result.worst_tick = tick;
    }
    result.forces_off += difference <= result.tolerance_n ? 0 : 1;
    result.levels_off += got.level != golden.level ? 1 : 0;
    result.contacts_off += got.contact != golden.contact ? 1 : 0;
}

std::string processor() {
    std::ifstream file("/proc/cpuinfo");
    for (std::string line; std::getline(file, line);) {
        if (line.starts_with("model name")) return line.substr(line.find(':') + 2);
    }
    return "unknown";
}

std::string certificate(const Bundle& bundle, const TrustVerdict& trust, const Qualification& result,
                        const RealTimeRights& rights) {
    const std::time_t now = std::time(nullptr);
    std::tm utc{};
    ::gmtime_r(&now, &utc);
    char stamp[32];
    std::strftime(stamp, sizeof(stamp), "%Y-%m-%dT%H:%M:%SZ", &utc);
    utsname machine{};
    ::uname(&machine);
    JsonWriter json;
    json.open('{').field("bundle", std::string_view(bundle.path()));
    // Of the whole file: b2sum -l 256 FILE says whether a certificate is this file's.
    json.field("bundle_blake2b_256", std::string_view(hex(blake2b_256(bundle.bytes())))).field("date", stamp);
    json.field("signature", std::string_view(trust.text())).field("trusted", trust.trust == Trust::trusted);
    json.field("program", "hapticlod-station " HAPTICLOD_VERSION).field("host", machine.nodename);
    json.field("kernel", std::string_view(std::string(machine.release) + " " + machine.version));
    json.field("processor", std::string_view(processor())).field("fifo", rights.fifo);
    json.field("memory_locked", rights.memory_locked);
    json.field("passed", result.forces_equal() && result.in_time());
    json.field("forces_equal", result.forces_equal()).field("in_time", result.in_time());
    json.field("ticks", result.ticks).field("rounds", std::uint32_t{kRounds});
    json.field("force_tolerance_n", result.tolerance_n).field("worst_force_difference_n", result.worst_force_n);
    json.field("worst_tick", result.worst_tick);
    json.field("forces_off", result.forces_off).field("levels_off", result.levels_off);
    json.field("contacts_off", result.contacts_off).field("budget_us", result.budget_us);
    for (const auto& [name, share] : {std::pair("p50", 0.5), std::pair("p99", 0.99), std::pair("p999", 0.999)}) {
        json.field(std::string("cost_") + name + "_us", result.cost->percentile_us(share));
    }
    json.field("cost_max_us", result.cost->max_us());
    return json.close().text();
}

void print(const Bundle& bundle, const Qualification& result) {
    std::printf("%s: golden motion of %llu ticks, %d times\n", bundle.path().c_str(),
                static_cast<unsigned long long>(result.ticks), kRounds);
    std::printf("  %-28s %14s %14s  %s\n", "", "here", "allowed", "");
    const auto row = [](const char* what, double here, double allowed, bool good) {
        std::printf("  %-28s %14.6g %14.6g  %s\n", what, here, allowed, good ? "pass" : "FAIL");
    };
    row("force difference, N", result.worst_force_n, result.tolerance_n, result.forces_off == 0);
    row("ticks on another level", static_cast<double>(result.levels_off), 0.0, result.levels_off == 0);
    row("ticks of other contact", static_cast<double>(result.contacts_off), 0.0, result.contacts_off == 0);
    row("loop cost p99.9, us", result.cost->percentile_us(0.999), result.budget_us, result.in_time());
    std::printf("%s\n", result.forces_equal() && result.in_time() ? "passed" : "FAILED");
}

}  // namespace

int command_qualify(Words words) {
    const auto parsed = Arguments::parse(
        words, {{"BUNDLE"}, {"--out", "--tolerance-n", "--cpu", "--trusted-keys"}, {"--json", "--accept-unsigned"}});
    if (!parsed) return refuse(parsed.fault());
    const Arguments& arguments = parsed.value();
    // The same x86-64 machine code gives the same bits; elsewhere rounding may differ in the last place.
    const auto tolerance = arguments.number("--tolerance-n", 1e-6, 0.0, 10.0);
    if (!tolerance) return refuse(tolerance.fault());
    const auto cpu = arguments.number("--cpu", -1.0, 0.0, 1023.0);
    if (!cpu) return refuse(cpu.fault());
    const auto opened = Bundle::open(arguments.positional(0));
    if (!opened) return refuse(opened.fault());
    const Bundle& bundle = opened.value();
    const auto trust = require_trust(bundle, arguments);
    if (!trust) return refuse(trust.fault());
    const auto motion = bundle.golden_motion();
    const auto golden = bundle.golden_record();
    if (golden.empty()) {
        return refuse({bundle.path(), "has no golden record to compare with", "tune it again with this version"});
    }
    Renderer renderer;
    if (std::string reason = bundle.prepare(renderer, bundle.config()); !reason.empty()) {
        return refuse({bundle.path(), reason, "write the bundle again"});
    }
    const int asked = static_cast<int>(cpu.value());
    const RealTimeRights rights = acquire_real_time(asked >= 0 ? std::optional<int>(asked) : std::nullopt);
    for (const std::string& line : rights.missing) std::fprintf(stderr, "real time: %s\n", line.c_str());

    Qualification result;
    result.ticks = motion.size();
    result.budget_us = bundle.config().budget_us;
    result.tolerance_n = tolerance.value();
    MonotonicClock clock;
    for (int round = 0; round < kRounds; ++round) {
        renderer.reset();
        for (std::size_t i = 0; i < motion.size(); ++i) {
            Pose pose;
            std::copy_n(motion[i].position_mm, 3, pose.position_mm);
            std::copy_n(motion[i].orientation, 4, pose.orientation);
            TickRecord record{};
            const std::int64_t before_ns = clock.now_ns();
            renderer.tick(pose, motion[i].time_s, record);
            result.cost->record(clock.now_ns() - before_ns);
            if (round == 0) compare(record, golden[i], i, result);
        }
    }
    const std::string json = certificate(bundle, trust.value(), result, rights);
    if (const auto path = arguments.option("--out")) {
        if (const auto fault = write_file_atomic(*path, json + "\n")) return refuse(*fault);
    }
    if (arguments.flag("--json")) {
        std::puts(json.c_str());
    } else {
        print(bundle, result);
    }
    return result.forces_equal() && result.in_time() ? kExitFine : kExitFault;
}

}  // namespace hapticlod::station
