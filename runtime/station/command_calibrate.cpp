// calibrate: this machine as a station file, for `hapticlod tune --station` anywhere.
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>

#include "io/atomic_file.hpp"
#include "station/arguments.hpp"
#include "station/clock.hpp"
#include "station/commands.hpp"
#include "station/cost_fit.hpp"
#include "station/histogram.hpp"
#include "station/profile_folder.hpp"
#include "station/realtime.hpp"
#include "station/stability.hpp"

namespace hapticlod::station {
namespace {

constexpr double kJitterSeconds = 3.0;
constexpr std::size_t kTicks = 1200;
constexpr double kQuick = 0.1;        // of both, for a look
constexpr double kBudgetShare = 0.6;  // of the period; the rest is for wake-up, device and safety

std::string number(double value) {
    char text[32];
    std::snprintf(text, sizeof(text), "%.6g", value);
    // TOML tells whole numbers from others; every field here is a real one.
    return std::string(text).find_first_of(".en") == std::string::npos ? std::string(text) + ".0" : text;
}

std::string quoted(const std::string& text) {
    std::string out = "\"";
    for (const char letter : text) {
        if (letter == '"' || letter == '\\') out += '\\';
        out += static_cast<unsigned char>(letter) < 0x20 ? ' ' : letter;
    }
    return out + "\"";
}

std::string processor() {
    std::ifstream file("/proc/cpuinfo");
    for (std::string line; std::getline(file, line);) {
        if (line.starts_with("model name")) return line.substr(line.find(':') + 2);
    }
    return "unknown processor";
}

// How late an absolute-time sleep ends, at the loop's rate, with the rights that could be had.
void measure_wake_up(double hz, double seconds, Histogram& late) {
    MonotonicClock clock;
    Schedule schedule(clock.now_ns(), 1.0 / hz);
    const auto count = static_cast<std::uint64_t>(seconds * hz);
    while (schedule.index() <= count) {
        clock.sleep_until(schedule.deadline_ns());
        const std::int64_t now_ns = clock.now_ns();
        late.record(now_ns - schedule.deadline_ns());
        (void)schedule.advance(now_ns);
    }
}

double cache_kb(int name) { return std::max(0.0, static_cast<double>(::sysconf(name)) / 1024.0); }

struct DeviceFacts {
    double max_force_n, stiffness_n_mm, encoder_mm, delay_ms, damping_n_s_mm, max_slew_n_s;
};

DeviceFacts facts_of(const DeviceProfile& profile, double period_s) {
    if (profile.simulated) {
        const SimulatedBody& body = *profile.simulated;
        const double delay_s = std::max(body.delay_s, period_s) + body.read_delay_s;
        const double limit = stability_limit_n_mm(body.device_damping_n_s_mm, 0.0, period_s, delay_s);
        return {body.max_force_n,
                std::min(1.0, kStiffnessShare * limit),
                body.encoder_mm,
                1e3 * delay_s,
                body.device_damping_n_s_mm,
                0.0};
    }
    const DeviceLimits& limits = profile.limits;
    return {limits.max_force_n,    std::min(1.0, kStiffnessShare * profile.stability_limit_n_mm(0.0, period_s)),
            limits.resolution_mm,  profile.timing.delay_ms,
            limits.damping_n_s_mm, 1e3 * limits.max_force_rate_n_ms};
}

std::string station_file(const std::string& name, double hz, const DeviceFacts& device, const std::string& device_name,
                         const CostPrices& prices, std::size_t ticks, const Histogram& late,
                         const RealTimeRights& rights) {
    std::ostringstream out;
    const double memory_mb =
        0.25e-6 * static_cast<double>(::sysconf(_SC_PHYS_PAGES)) * static_cast<double>(::sysconf(_SC_PAGESIZE));
    out << "# Written by hapticlod-station calibrate.\n";
    out << "name = " << quoted(name) << "\nloop_hz = " << number(hz) << "\n";
    out << "budget_us = " << number(kBudgetShare * 1e6 / hz) << "  # 60 % of the period\n";
    out << "memory_mb = " << number(std::floor(memory_mb)) << "  # a quarter of this machine's\n";
    out << "# The device: " << device_name << "\n";
    out << "stiffness_n_mm = " << number(device.stiffness_n_mm) << "\nmax_force_n = " << number(device.max_force_n)
        << "\nmax_slew_n_s = " << number(device.max_slew_n_s) << "\nencoder_mm = " << number(device.encoder_mm)
        << "\ndelay_ms = " << number(device.delay_ms) << "\n";
    if (device.damping_n_s_mm > 0.0) out << "device_damping_n_s_mm = " << number(device.damping_n_s_mm) << "\n";
    out << "\n[cost]\n";
    for (std::size_t i = 0; i < prices.price_ns.size(); ++i) {
        out << kPriceNames[i] << " = " << number(prices.price_ns[i]) << "\n";
    }
    out << "cache_mb = " << number(kCacheMb) << "\ncache_gain = " << number(prices.cache_gain)
        << "\ntail_p99 = " << number(prices.tail_p99) << "\ntail_p999 = " << number(prices.tail_p999)
        << "\nmeasured_on = " << quoted(processor() + ", " + std::to_string(ticks) + " ticks") << "\n";
    out << "\n[machine]\n";
    out << "wake_up_p50_us = " << number(late.percentile_us(0.5))
        << "\nwake_up_p99_us = " << number(late.percentile_us(0.99))
        << "\nwake_up_p999_us = " << number(late.percentile_us(0.999)) << "\nwake_up_max_us = " << number(late.max_us())
        << "\n";
    out << "l1d_kb = " << number(cache_kb(_SC_LEVEL1_DCACHE_SIZE))
        << "\nl2_kb = " << number(cache_kb(_SC_LEVEL2_CACHE_SIZE))
        << "\nl3_kb = " << number(cache_kb(_SC_LEVEL3_CACHE_SIZE)) << "\n";
    out << "real_time = " << (rights.fifo && rights.memory_locked ? "true" : "false") << "\n";
    return out.str();
}

}  // namespace

int command_calibrate(Words words) {
    const auto parsed = Arguments::parse(words, {{}, {"--out", "--device", "--rate", "--name", "--cpu"}, {"--quick"}});
    if (!parsed) return refuse(parsed.fault());
    const Arguments& arguments = parsed.value();
    const auto out = arguments.option("--out");
    if (!out) return refuse({"--out", "is missing", "say where the station file goes: --out STATION.toml"});
    const std::filesystem::path folder = std::filesystem::path(*out).parent_path();
    if (::access(folder.empty() ? "." : folder.c_str(), W_OK) != 0) {  // before the seconds that measuring takes
        return refuse({*out, "cannot be written", "choose a folder that exists and is writable"});
    }
    const auto hz = arguments.number("--rate", 1000.0, 100.0, 20'000.0);
    if (!hz) return refuse(hz.fault());
    const auto cpu = arguments.number("--cpu", -1.0, 0.0, 1023.0);
    if (!cpu) return refuse(cpu.fault());
    const auto profile = find_profile(arguments.option("--device").value_or("sim"));
    if (!profile) return refuse(profile.fault());
    if (!profile.value().simulated && !profile.value().output) {
        return refuse({profile.value().file, "has no motors: there is nothing to render on it", "give another device"});
    }
    char host[256] = "station";
    (void)::gethostname(host, sizeof(host) - 1);

    const int asked = static_cast<int>(cpu.value());
    const RealTimeRights rights = acquire_real_time(asked >= 0 ? std::optional<int>(asked) : std::nullopt);
    for (const std::string& line : rights.missing) std::fprintf(stderr, "real time: %s\n", line.c_str());
    const bool watched = ::isatty(STDERR_FILENO) != 0;
    const auto late = std::make_unique<Histogram>();
    const double share_of_course = arguments.flag("--quick") ? kQuick : 1.0;
    measure_wake_up(hz.value(), share_of_course * kJitterSeconds, *late);
    const auto ticks = static_cast<std::size_t>(share_of_course * static_cast<double>(kTicks));
    const Course course = run_cost_course(ticks, [watched](double share) {
        if (watched) std::fprintf(stderr, "\rtiming ticks: %3.0f %%%s", 100.0 * share, share >= 1.0 ? "\n" : "");
    });
    const CostPrices prices = fit_prices(course.fitted);

    const std::string text =
        station_file(arguments.option("--name").value_or(host), hz.value(), facts_of(profile.value(), 1.0 / hz.value()),
                     profile.value().name, prices, course.fitted.size(), *late, rights);
    if (const auto fault = write_file_atomic(*out, text)) return refuse(*fault);
    std::printf("%s: %zu ticks; on a surface and with tools that were left out, the mean is predicted as\n",
                out->c_str(), course.fitted.size());
    for (const HeldOut& kept : course.held_out) {
        const Agreement agreement = compare(prices, kept.ticks);
        std::printf("  %.2f of what was measured, p99.9 as %.2f, half of the ticks within %.0f %%: %s\n",
                    agreement.mean_ratio, agreement.p999_ratio, 100.0 * agreement.median_error, kept.tool);
    }
    std::printf("  wake-up p50 %.1f, p99 %.1f, p99.9 %.1f, max %.1f us\n", late->percentile_us(0.5),
                late->percentile_us(0.99), late->percentile_us(0.999), late->max_us());
    if (late->percentile_us(0.999) > (1.0 - kBudgetShare) * 1e6 / hz.value()) {
        std::printf("  wake-ups alone take more than the budget leaves: hapticlod-station doctor says what to do\n");
    }
    return kExitFine;
}

}  // namespace hapticlod::station
