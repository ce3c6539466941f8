#include "station/cost_course.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "core/renderer.hpp"
#include "station/clock.hpp"

namespace hapticlod::station {
namespace {

constexpr double kSide_mm = 40.0, kHz = 1000.0;
constexpr int kRepeats = 3;
constexpr std::uint32_t kGrids[] = {64, 160, 400};  // 8 k, 51 k, 320 k triangles
constexpr std::uint32_t kHeldOutGrid = 250;         // 125 k

double height_mm(double x, double y) {
    return 0.8 * std::sin(0.7 * x) * std::cos(0.5 * y) + 0.15 * std::sin(3.1 * x + 1.0) * std::sin(2.7 * y);
}

struct Surface {
    LevelStorage level;
    double cell_mm;
};

Surface surface(std::uint32_t grid) {
    const double step = kSide_mm / grid;
    std::vector<float> vertices;
    std::vector<std::uint32_t> faces;
    for (std::uint32_t j = 0; j <= grid; ++j) {
        for (std::uint32_t i = 0; i <= grid; ++i) {
            const double x = step * i - 0.5 * kSide_mm, y = step * j - 0.5 * kSide_mm;
            for (const double value : {x, y, height_mm(x, y)}) vertices.push_back(static_cast<float>(value));
        }
    }
    for (std::uint32_t j = 0; j < grid; ++j) {
        for (std::uint32_t i = 0; i < grid; ++i) {
            const std::uint32_t a = j * (grid + 1) + i, b = a + 1, c = a + grid + 1, d = c + 1;
            faces.insert(faces.end(), {a, b, d, a, d, c});
        }
    }
    Surface made{{}, 4.0 * step};
    if (const std::string reason = made.level.build(vertices, faces, made.cell_mm); !reason.empty()) {
        throw std::runtime_error(reason);
    }
    return made;
}

std::vector<BallData> ball(double radius_mm) { return {{{0.0, 0.0, 0.0}, radius_mm}}; }

// An ellipsoid of 96 balls, 6 mm long.
std::vector<BallData> burr() {
    std::vector<BallData> balls;
    for (int i = 0; i < 96; ++i) {
        const double z = -1.0 + 2.0 * (i + 0.5) / 96, turn = 2.399963 * i;  // golden angle
        const double across = std::sqrt(1.0 - z * z);
        balls.push_back({{0.9 * across * std::cos(turn), 0.9 * across * std::sin(turn), 3.0 * z + 3.0}, 0.25});
    }
    return balls;
}

// A bent rod of 200 balls that thins towards its end, where it touches: an explorer.
std::vector<BallData> explorer() {
    std::vector<BallData> balls;
    for (int i = 0; i < 200; ++i) {
        const double along = 0.06 * i;
        balls.push_back({{0.04 * along * along, 0.0, along}, 0.2 + 0.03 * along});
    }
    return balls;
}

// Over the surface at up to `speed_mm_s`, pressed in for three quarters of the time, else up to 10 mm above it: what a
// tick costs that touches nothing shows there. The tool leans to and fro: its balls are turned with it in every tick.
Pose hand(double t, double speed_mm_s, double radius_mm) {
    Pose pose{};
    const double reach = 15.0, w = speed_mm_s / reach;
    pose.position_mm[0] = reach * std::sin(w * t);
    pose.position_mm[1] = 0.7 * reach * std::sin(0.73 * w * t + 0.4);
    const double wave = 1.5 + 2.0 * std::sin(9.0 * t);
    const double press = wave > 0.0 ? 0.35 * std::min(1.0, wave) : 20.0 * wave;
    pose.position_mm[2] = height_mm(pose.position_mm[0], pose.position_mm[1]) + radius_mm - press;
    const double lean = 0.3 * std::sin(0.8 * t);
    pose.orientation[0] = std::cos(0.5 * lean);
    pose.orientation[2] = std::sin(0.5 * lean);
    return pose;
}

class Timer {
public:
    explicit Timer(std::size_t ticks) : ticks_(ticks) {}
    void run(std::span<const Surface* const> surfaces, std::span<const BallData> tool, double speed_mm_s,
             std::vector<TimedTick>& out) {
        ConfigData config{};
        config.version = kConfigVersion;
        config.level_count = static_cast<std::uint32_t>(surfaces.size());
        config.mapping = static_cast<std::uint32_t>(Mapping::two_sided);
        config.loop_hz = kHz;
        config.budget_us = 1e6 / kHz;
        config.stiffness_n_mm = 1.0;
        config.filter_hz = 30.0;
        config.hysteresis = 0.1;
        config.l_in_mm = config.l_out_mm = config.closest_bound_mm = 1.0;
        config.max_force_n = 10.0;
        config.speeds_mm_s[0] = 0.6 * speed_mm_s;
        std::vector<LevelView> views;
        for (std::size_t i = 0; i < surfaces.size(); ++i) {
            views.push_back(surfaces[i]->level.view());
            config.cell_mm[i] = surfaces[i]->cell_mm;
            config.triangles[i] = views[i].triangle_count();
            config.balls[i] = static_cast<std::uint32_t>(tool.size());
        }
        Renderer renderer;
        if (const std::string reason = renderer.load(config, views, tool); !reason.empty()) {
            throw std::runtime_error(reason);
        }
        std::vector<TickRecord> records(ticks_);
        for (int repeat = 0; repeat < kRepeats; ++repeat) {
            renderer.reset();
            for (std::size_t i = 0; i < ticks_; ++i) {
                const double t = static_cast<double>(i) / kHz;
                const Pose pose = hand(t, speed_mm_s, tool[0].radius_mm);
                TickRecord record{};
                const std::int64_t before_ns = clock_.now_ns();
                renderer.tick(pose, t, record);
                record.cost_ns = static_cast<float>(clock_.now_ns() - before_ns);
                if (repeat == 0 || record.cost_ns < records[i].cost_ns) records[i] = record;
            }
        }
        for (const TickRecord& record : records) {
            out.push_back({record, static_cast<double>(views[record.level].bytes()), static_cast<double>(tool.size())});
        }
    }

private:
    std::size_t ticks_;
    MonotonicClock clock_;
};

}  // namespace

Course run_cost_course(std::size_t ticks, const std::function<void(double)>& progress) {
    std::vector<Surface> surfaces;
    for (const std::uint32_t grid : kGrids) surfaces.push_back(surface(grid));
    const std::vector<std::vector<BallData>> tools = {ball(0.0), ball(0.5), ball(1.5), burr()};
    constexpr double kSpeeds[] = {20.0, 90.0, 300.0};
    Course course;
    Timer timer(ticks);
    double done = 0.0;
    for (const auto& tool : tools) {
        for (const double speed : kSpeeds) {
            for (const Surface& one : surfaces) {
                const Surface* only[] = {&one};
                timer.run(only, tool, speed, course.fitted);
            }
            const Surface* both[] = {&surfaces[1], &surfaces[0]};  // mapping is counted where levels change
            timer.run(both, tool, speed, course.fitted);
            progress(++done / static_cast<double>(tools.size() * std::size(kSpeeds) + 1));
        }
    }
    const Surface unseen = surface(kHeldOutGrid);
    const Surface* only[] = {&unseen};
    course.held_out = {{"a ball", {}}, {"an explorer of 200 balls", {}}};
    for (const double speed : {50.0, 200.0}) {
        timer.run(only, ball(1.0), speed, course.held_out[0].ticks);
        timer.run(only, explorer(), speed, course.held_out[1].ticks);
    }
    progress(1.0);
    return course;
}

}  // namespace hapticlod::station
