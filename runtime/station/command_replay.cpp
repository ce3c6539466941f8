// replay: a motion through the renderer, as fast as it goes; what every tick gave, as CSV.
#include <algorithm>
#include <cstdio>
#include <vector>

#include "core/renderer.hpp"
#include "io/atomic_file.hpp"
#include "io/bundle.hpp"
#include "io/motion_csv.hpp"
#include "io/motion_interpolation.hpp"
#include "io/record_csv.hpp"
#include "station/arguments.hpp"
#include "station/clock.hpp"
#include "station/commands.hpp"
#include "station/histogram.hpp"

namespace hapticlod::station {

int command_replay(Words words) {
    const auto arguments = Arguments::parse(words, {{"BUNDLE", "MOTION.csv", "OUT.csv"}, {}, {}});
    if (!arguments) return refuse(arguments.fault());
    const auto bundle = Bundle::open(arguments.value().positional(0));
    if (!bundle) return refuse(bundle.fault());
    const std::string& motion_path = arguments.value().positional(1);
    auto motion = read_motion_csv(motion_path);
    if (!motion) return refuse(motion.fault());
    std::vector<MotionRow> rows = std::move(motion).value();

    const ConfigData& config = bundle.value().config();
    if (!has_rate(rows, config.loop_hz)) {
        rows = resample_motion(rows, config.loop_hz);
        std::fprintf(stderr, "%s: resampled to the bundle's %g Hz\n", motion_path.c_str(), config.loop_hz);
    }
    Renderer renderer;
    if (std::string reason = bundle.value().prepare(renderer, config); !reason.empty()) {
        return refuse({bundle.value().path(), reason, "write the bundle again"});
    }

    std::vector<TickRecord> records(rows.size());
    MonotonicClock clock;
    Histogram cost;
    for (std::size_t i = 0; i < rows.size(); ++i) {
        Pose pose;
        std::copy_n(rows[i].position_mm, 3, pose.position_mm);
        std::copy_n(rows[i].orientation, 4, pose.orientation);
        const std::int64_t before_ns = clock.now_ns();
        renderer.tick(pose, rows[i].time_s, records[i]);
        const std::int64_t cost_ns = clock.now_ns() - before_ns;
        records[i].cost_ns = static_cast<float>(cost_ns);
        cost.record(cost_ns);
    }
    const std::string& out_path = arguments.value().positional(2);
    if (const auto fault = write_file_atomic(out_path, record_csv(records))) return refuse(*fault);
    std::printf("%s: %zu ticks, loop cost p50 %.2f, p99 %.2f, p99.9 %.2f, max %.2f us\n", out_path.c_str(), rows.size(),
                cost.percentile_us(0.5), cost.percentile_us(0.99), cost.percentile_us(0.999), cost.max_us());
    return kExitFine;
}

}  // namespace hapticlod::station
