// The loop with a scripted device in simulated time.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "bundle_maker.hpp"
#include "station/loop.hpp"

namespace hapticlod::station {
namespace {

// Gives what the script says; remembers what was sent.
class ScriptedDevice final : public Device {
public:
    using Script = std::function<DeviceReading(int tick, double now_s)>;
    explicit ScriptedDevice(Script script) : script_(std::move(script)) {}
    DeviceTraits traits() const noexcept override { return {"script", 4.0, 1000.0, 0.0, 0.005, 1e-3}; }
    DeviceReading read(std::int64_t now_ns) noexcept override {
        return script_(tick_++, static_cast<double>(now_ns) * 1e-9);
    }
    void write(std::int64_t, const double force_n[3], bool) noexcept override {
        sent.push_back({force_n[0], force_n[1], force_n[2]});
    }
    std::vector<std::array<double, 3>> sent;

private:
    Script script_;
    int tick_ = 0;
};

struct Stage {
    Stage() {
        storage.push_back(test::plate(6, 1.5));
        storage.push_back(test::plate(3, 3.0));
        views = {storage[0].view(), storage[1].view()};
        EXPECT_EQ(renderer.load(config, views, std::vector<BallData>(1)), "");
        safety.arm();
    }
    LoopOutcome run(Device& device, LoopClock& clock, std::uint64_t periods) {
        return run_loop(renderer, device, safety, clock, {1e-3, config.budget_us, periods, 2}, stop, tally);
    }
    ConfigData config = test::plate_config();
    std::vector<LevelStorage> storage;
    std::vector<LevelView> views;
    Renderer renderer;
    SafetyCore safety{{1e-3, 500.0, 4.0, 0.0, 1000.0, 0.0, 0.0}};
    std::atomic<bool> stop{false};
    Tally tally;
    VirtualClock clock;
};

// Sinks to 0.5 mm under the plate and slides there, slowly for 0.5 s, then fast.
DeviceReading slide(double now_s) {
    const double z = 20.0 - std::min(0.5, 5.0 * (now_s - 0.02));
    const double x = now_s < 0.6 ? 2.0 * now_s : 1.2 + 60.0 * (now_s - 0.6);
    return {{{x - 4.0, 0.3, z}}, now_s};
}

TEST(Loop, RendersWhatTheRendererRenders) {
    Stage stage;
    ScriptedDevice device([](int, double now_s) { return slide(now_s); });
    const LoopOutcome outcome = stage.run(device, stage.clock, 700);
    EXPECT_EQ(stage.safety.state(), State::run);
    EXPECT_EQ(stage.tally.ticks, 700u);
    EXPECT_NEAR(outcome.elapsed_s, 0.7, 1e-12);
    EXPECT_EQ(stage.tally.wake_up.max_us(), 0.0);
    ASSERT_EQ(device.sent.size(), 701u);
    for (const double force : device.sent.back()) EXPECT_EQ(force, 0.0);  // a loop never ends with a force
    EXPECT_NEAR(device.sent[400][2], 0.5, 1e-3);
    EXPECT_NEAR(device.sent[690][2], 0.5, 1e-3);  // on the coarse level
    EXPECT_GT(stage.tally.level_ticks[1], 50u);
    EXPECT_EQ(stage.tally.switches, 1u);
    EXPECT_EQ(stage.tally.mappings[static_cast<int>(MappingOutcome::hit)], 1u);
    EXPECT_NEAR(stage.tally.max_force_n, 0.5, 1e-2);
    EXPECT_EQ(device.sent[5][2], 0.0);  // armed, not running yet
}

TEST(Loop, SimulatedTimeIsRepeatable) {
    std::vector<std::array<double, 3>> first;
    for (int repeat = 0; repeat < 2; ++repeat) {
        Stage stage;
        ScriptedDevice device([](int, double now_s) { return slide(now_s); });
        (void)stage.run(device, stage.clock, 300);
        if (repeat == 0) first = device.sent;
        if (repeat == 1) {
            EXPECT_EQ(device.sent, first);
        }
    }
}

TEST(Loop, BadPositionsEndInSafeWithZeroForce) {
    Stage stage;
    ScriptedDevice device([](int tick, double now_s) {
        DeviceReading reading = slide(now_s);
        if (tick >= 200) reading.pose.position_mm[1] = NAN;
        return reading;
    });
    (void)stage.run(device, stage.clock, 1000);
    EXPECT_EQ(stage.safety.state(), State::safe);
    EXPECT_EQ(stage.safety.fault(), SafetyFault::position_not_finite);
    ASSERT_EQ(device.sent.size(), 204u);  // ticks 0..202 and the last zero
    EXPECT_GT(device.sent[201][2], 0.4);  // held for two ticks
    for (const double force : device.sent[202]) EXPECT_EQ(force, 0.0);
}

TEST(Loop, TeleportIsNotRendered) {
    Stage stage;
    ScriptedDevice device([](int tick, double now_s) {
        DeviceReading reading = slide(now_s);
        if (tick == 200 || tick == 201) reading.pose.position_mm[2] = 10.0;  // 10 mm deep
        return reading;
    });
    (void)stage.run(device, stage.clock, 400);
    EXPECT_EQ(stage.safety.state(), State::degraded);
    EXPECT_EQ(stage.safety.counts().positions_rejected, 2u);
    for (std::size_t i = 150; i < 400; ++i) EXPECT_NEAR(device.sent[i][2], 0.5, 1e-2) << i;
}

TEST(Loop, StopEndsItInOrder) {
    Stage stage;
    ScriptedDevice device([&stage](int tick, double now_s) {
        if (tick == 150) stage.stop = true;
        return slide(now_s);
    });
    (void)stage.run(device, stage.clock, 0);
    EXPECT_EQ(stage.tally.ticks, 151u);
    EXPECT_EQ(device.sent.size(), 152u);
    for (const double force : device.sent.back()) EXPECT_EQ(force, 0.0);
}

// Real by name, scripted in time: every tick takes as long as it is told.
class SlowClock final : public LoopClock {
public:
    std::int64_t now_ns() noexcept override { return now; }
    void sleep_until(std::int64_t deadline_ns) noexcept override {
        now = std::max(now, deadline_ns) + (++sleeps % every == 0 ? late_ns : 0);
    }
    bool real() const noexcept override { return true; }
    std::int64_t now = 0, late_ns = 0;
    int sleeps = 0, every = 1;
};

TEST(Loop, LateWakeUpsKeepThePhaseAndAreCounted) {
    Stage stage;
    stage.config.budget_us = 1e9;  // this test is about waking up: computing may take what a busy machine takes
    ScriptedDevice device([](int, double now_s) { return slide(now_s); });
    SlowClock clock;
    clock.every = 50;
    clock.late_ns = 4'300'000;
    (void)stage.run(device, clock, 500);
    EXPECT_EQ(stage.tally.ticks, 500u - 9u * 4u);
    EXPECT_EQ(stage.tally.skipped, 9u * 4u);
    EXPECT_EQ(stage.safety.counts().late_periods, 9u);
    EXPECT_NEAR(stage.tally.wake_up.max_us(), 4300.0, 1e-9);
    EXPECT_EQ(stage.tally.wake_up.percentile_us(0.5), 0.0);  // all other ticks were on their deadline
    EXPECT_EQ(clock.now, 500'000'000);                       // the phase is still whole milliseconds
    EXPECT_EQ(stage.safety.state(), State::degraded);
}

TEST(Loop, TwentyLatePeriodsInARowAreSafe) {
    Stage stage;
    ScriptedDevice device([](int, double now_s) { return slide(now_s); });
    SlowClock clock;
    clock.late_ns = 2'500'000;
    (void)stage.run(device, clock, 500);
    EXPECT_EQ(stage.safety.fault(), SafetyFault::overruns);
    EXPECT_EQ(stage.safety.counts().longest_overrun_run, 20u);
    EXPECT_LT(stage.tally.ticks, 30u);
}

TEST(Loop, OverBudgetTicksGoCoarser) {
    Stage stage;
    stage.config.budget_us = 1e-3;  // nothing is that fast
    ScriptedDevice device([](int, double now_s) { return slide(now_s); });
    SlowClock clock;
    const LoopOutcome outcome = stage.run(device, clock, 500);
    EXPECT_EQ(outcome.coarser_by_overrun, 1u);  // two levels: it can rise once
    EXPECT_GT(stage.tally.level_ticks[1], 3 * stage.tally.level_ticks[0]);
    EXPECT_EQ(stage.tally.longest_over_budget_run, stage.tally.ticks);
}

}  // namespace
}  // namespace hapticlod::station
