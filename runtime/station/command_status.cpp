// status: what a running station does, ten times a second in a plain terminal. It only reads shared memory.
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <memory>
#include <thread>

#include "io/json_text.hpp"
#include "station/arguments.hpp"
#include "station/commands.hpp"
#include "station/histogram.hpp"
#include "station/safety.hpp"
#include "station/stop_signal.hpp"
#include "station/telemetry.hpp"

namespace hapticlod::station {
namespace {

// The last second, or less where less is there.
struct Window {
    TelemetryFrame last{};
    double hz = 0.0;
    std::unique_ptr<Histogram> cost = std::make_unique<Histogram>(), wake_up = std::make_unique<Histogram>();
    std::uint64_t frames = 0, over_budget = 0, lost = 0, contact = 0;
    double most_force_n = 0.0;
    std::vector<std::uint64_t> level_ticks = std::vector<std::uint64_t>(kMaxLevels, 0);
};

double norm(const float v[3]) { return std::hypot(double{v[0]}, double{v[1]}, double{v[2]}); }

Window look(const TelemetryRing& ring) {
    Window window;
    const TelemetrySource& source = ring.source();
    const std::vector<TelemetryFrame> frames = ring.newest(static_cast<std::uint64_t>(std::ceil(source.loop_hz)));
    window.frames = frames.size();
    if (frames.empty()) return window;
    window.last = frames.back();
    const double span_s = static_cast<double>(frames.back().now_ns - frames.front().now_ns) * 1e-9;
    if (span_s > 0.0) window.hz = static_cast<double>(frames.size() - 1) / span_s;
    for (const TelemetryFrame& frame : frames) {
        window.cost->record(std::llround(1e3 * double{frame.cost_us}));
        window.wake_up->record(std::llround(1e3 * double{frame.wake_up_us}));
        window.over_budget += double{frame.cost_us} > source.budget_us ? 1 : 0;
        window.lost += frame.lost;
        window.contact += frame.contact;
        window.most_force_n = std::max(window.most_force_n, norm(frame.force_n));
        ++window.level_ticks[std::min<std::size_t>(frame.level, kMaxLevels - 1)];
    }
    return window;
}

const char* state_of(const Window& window) { return name_of(static_cast<State>(window.last.state)); }
const char* fault_of(const Window& window) { return name_of(static_cast<SafetyFault>(window.last.fault)); }

void print_text(const TelemetryRing& ring, const Window& window, bool in_place) {
    const TelemetrySource& source = ring.source();
    if (in_place) std::fputs("\x1b[H\x1b[J", stdout);  // to the top, clear
    std::printf("%s on %s, pid %u: %s, fault: %s\n", source.bundle, source.device, source.pid, state_of(window),
                fault_of(window));
    std::printf("  rate     %8.1f Hz of %g, %llu ticks in all\n", window.hz, source.loop_hz,
                static_cast<unsigned long long>(ring.pushed()));
    for (const auto& [name, h] : {std::pair("cost", window.cost.get()), std::pair("wake-up", window.wake_up.get())}) {
        std::printf("  %-8s %8.1f us p50, %.1f p99, %.1f max\n", name, h->percentile_us(0.5), h->percentile_us(0.99),
                    h->max_us());
    }
    std::printf(
        "  speed    %8.1f mm/s, force %.2f N (most %.2f), in contact %.0f %%, over budget %llu, lost %llu\n",
        double{window.last.speed_mm_s}, norm(window.last.force_n), window.most_force_n,
        window.frames == 0 ? 0.0 : 100.0 * static_cast<double>(window.contact) / static_cast<double>(window.frames),
        static_cast<unsigned long long>(window.over_budget), static_cast<unsigned long long>(window.lost));
    for (std::uint32_t level = 0; level < std::min(source.level_count, kMaxLevels); ++level) {
        const double share = window.frames == 0
                                 ? 0.0
                                 : static_cast<double>(window.level_ticks[level]) / static_cast<double>(window.frames);
        std::printf("  level %u %c %9u triangles %5.1f %% %s\n", level, window.last.level == level ? '>' : ' ',
                    source.triangles[level], 100.0 * share,
                    std::string(static_cast<std::size_t>(std::lround(40.0 * share)), '#').c_str());
    }
    std::fflush(stdout);
}

void print_histogram(const TelemetryRing& ring) {
    constexpr int kRows = 14;  // 1 us to 8 ms, an octave each
    std::uint64_t rows[kRows] = {};
    std::uint64_t most = 1;
    for (const TelemetryFrame& frame : ring.newest(static_cast<std::uint64_t>(ring.source().loop_hz))) {
        const double octave = std::floor(std::log2(std::max(1.0, double{frame.cost_us})));
        most = std::max(most, ++rows[std::min(kRows - 1, static_cast<int>(octave))]);
    }
    for (int i = 0; i < kRows; ++i) {
        if (rows[i] == 0) continue;
        const auto length = static_cast<std::size_t>(1 + 39 * rows[i] / most);
        std::printf("  %5d us+ %7llu %s\n", 1 << i, static_cast<unsigned long long>(rows[i]),
                    std::string(length, '#').c_str());
    }
    std::fflush(stdout);
}

std::string as_json(const TelemetryRing& ring, const Window& window) {
    const TelemetrySource& source = ring.source();
    JsonWriter json;
    json.open('{').field("bundle", std::string_view(source.bundle)).field("device", std::string_view(source.device));
    json.field("pid", source.pid).field("state", state_of(window)).field("fault", fault_of(window));
    json.field("hz", window.hz).field("loop_hz", source.loop_hz).field("ticks", ring.pushed());
    json.field("cost_p50_us", window.cost->percentile_us(0.5)).field("cost_p99_us", window.cost->percentile_us(0.99));
    json.field("wake_up_p99_us", window.wake_up->percentile_us(0.99)).field("over_budget", window.over_budget);
    json.field("level", std::uint32_t{window.last.level}).field("speed_mm_s", double{window.last.speed_mm_s});
    json.field("force_n", norm(window.last.force_n)).field("most_force_n", window.most_force_n);
    return json.close().text();
}

}  // namespace

int command_status(Words words) {
    const auto parsed = Arguments::parse(words, {{}, {"--pid"}, {"--once", "--json"}});
    if (!parsed) return refuse(parsed.fault());
    const Arguments& arguments = parsed.value();
    const auto pid = arguments.number("--pid", 0.0, 1.0, 4194304.0);
    if (!pid) return refuse(pid.fault());
    const auto opened = TelemetryRing::open(static_cast<std::uint32_t>(pid.value()));
    if (!opened) return refuse(opened.fault());
    const TelemetryRing& ring = opened.value();
    const std::atomic<bool>& stop = stop_signal();
    const bool once = arguments.flag("--once") || ::isatty(STDOUT_FILENO) == 0;
    do {
        const Window window = look(ring);
        if (arguments.flag("--json")) {
            std::puts(as_json(ring, window).c_str());
        } else {
            print_text(ring, window, !once);
            print_histogram(ring);
        }
        if (once) break;
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
    } while (!stop.load() && process_lives(ring.source().pid));
    return kExitFine;
}

}  // namespace hapticlod::station
