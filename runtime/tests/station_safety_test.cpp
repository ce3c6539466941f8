// The safety core: every state, every row of the fault table that needs no real device, and what guards the loop.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "station/overrun.hpp"
#include "station/safety.hpp"
#include "station/stability.hpp"

namespace hapticlod::station {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kT = 1e-3;

SafetyLimits limits() { return {kT, 500.0, 4.0, 0.0, 1000.0, 0.02, 0.0}; }

// A core with time: each step is one good tick unless told otherwise.
struct Bench {
    explicit Bench(const SafetyLimits& with = limits()) : core(with) { core.arm(); }

    Pose read(double x_mm) {
        time_s += kT;
        return core.accept({{{x_mm, 0.0, 0.0}}, time_s});
    }
    double send(double x_n) {
        const double wanted[3] = {x_n, 0.0, 0.0};
        core.gate(wanted, kT, sent);
        return sent[0];
    }
    void run() {
        for (unsigned i = 0; i < SafetyCore::kArmReadings; ++i) (void)read(0.0);
    }

    SafetyCore core;
    double time_s = 0.0;
    double sent[3] = {0.0, 0.0, 0.0};
};

TEST(Safety, StartsIdleAndArmsBeforeItRuns) {
    SafetyCore idle(limits());
    EXPECT_EQ(idle.state(), State::idle);
    for (int i = 0; i < 20; ++i) (void)idle.accept({{{0.0, 0.0, 0.0}}, i * kT});
    EXPECT_EQ(idle.state(), State::idle);

    Bench bench;
    EXPECT_EQ(bench.core.state(), State::armed);
    for (unsigned i = 0; i + 1 < SafetyCore::kArmReadings; ++i) {
        (void)bench.read(0.0);
        EXPECT_EQ(bench.core.state(), State::armed);
        EXPECT_EQ(bench.send(1.0), 0.0);
    }
    (void)bench.read(0.0);
    EXPECT_EQ(bench.core.state(), State::run);
    EXPECT_EQ(bench.send(1.0), 1.0);
}

TEST(Safety, ArmingNeedsGoodReadingsInARow) {
    Bench bench;
    for (int i = 0; i < 9; ++i) (void)bench.read(0.0);
    (void)bench.read(kNan);
    for (int i = 0; i < 9; ++i) (void)bench.read(0.0);
    EXPECT_EQ(bench.core.state(), State::armed);
    (void)bench.read(0.0);
    EXPECT_EQ(bench.core.state(), State::run);
}

TEST(Safety, PositionThatIsNotFiniteIsHeldTwiceThenSafe) {
    Bench bench;
    bench.run();
    (void)bench.read(0.5);
    for (unsigned i = 0; i < SafetyCore::kHeldTicks; ++i) {
        EXPECT_EQ(bench.read(i == 0 ? kNan : INFINITY).position_mm[0], 0.5);
        EXPECT_EQ(bench.core.state(), State::degraded);
        EXPECT_EQ(bench.send(1.0), 1.0);
    }
    EXPECT_EQ(bench.read(kNan).position_mm[0], 0.5);
    EXPECT_EQ(bench.core.state(), State::safe);
    EXPECT_EQ(bench.core.fault(), SafetyFault::position_not_finite);
    EXPECT_EQ(bench.send(1.0), 0.0);
    EXPECT_EQ(bench.core.counts().positions_not_finite, 3u);
}

TEST(Safety, OrientationAndTimeCountAsPosition) {
    Bench bench;
    bench.run();
    (void)bench.core.accept({{{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0, 0.0}}, bench.time_s + kT});
    (void)bench.core.accept({{{0.0, 0.0, 0.0}, {kNan, 0.0, 0.0, 0.0}}, bench.time_s + 2 * kT});
    EXPECT_EQ(bench.core.state(), State::degraded);
    (void)bench.core.accept({{{0.0, 0.0, 0.0}}, kNan});
    EXPECT_EQ(bench.core.state(), State::safe);
}

TEST(Safety, GoodReadingEndsARowOfBadOnes) {
    Bench bench;
    bench.run();
    for (int i = 0; i < 50; ++i) {
        (void)bench.read(kNan);
        (void)bench.read(kNan);
        EXPECT_EQ(bench.read(0.1).position_mm[0], 0.1);
    }
    EXPECT_EQ(bench.core.state(), State::degraded);
}

TEST(Safety, PositionJumpIsRejectedTwiceThenSafe) {
    Bench bench;
    bench.run();
    EXPECT_EQ(bench.read(0.9).position_mm[0], 0.9);  // 900 mm/s: fast, but a hand
    EXPECT_EQ(bench.read(50.0).position_mm[0], 0.9);
    EXPECT_EQ(bench.read(50.0).position_mm[0], 0.9);
    EXPECT_EQ(bench.core.state(), State::degraded);
    (void)bench.read(50.0);
    EXPECT_EQ(bench.core.state(), State::safe);
    EXPECT_EQ(bench.core.fault(), SafetyFault::position_jump);
    EXPECT_EQ(bench.core.counts().positions_rejected, 3u);
}

TEST(Safety, LateReadingMayBeFurtherAwayAndEncoderStepsAreNoSpeed) {
    Bench bench;
    bench.run();
    bench.time_s += 0.029;  // 30 ms without a reading: 20 mm are 667 mm/s
    EXPECT_EQ(bench.read(20.0).position_mm[0], 20.0);
    EXPECT_EQ(bench.core.counts().positions_rejected, 0u);
    // The same time stamp twice, one encoder step apart: no infinite speed.
    EXPECT_EQ(bench.core.accept({{{20.02, 0.0, 0.0}}, bench.time_s}).position_mm[0], 20.02);
    EXPECT_EQ(bench.core.counts().positions_rejected, 0u);
}

TEST(Safety, ForceThatIsNotFiniteStopsAtOnce) {
    for (const double bad : {kNan, kInfinity, -kInfinity, 1e300}) {
        Bench bench;
        bench.run();
        EXPECT_EQ(bench.send(1.0), 1.0);
        const double sent = bench.send(bad);
        EXPECT_EQ(sent, 0.0) << bad;
        EXPECT_EQ(bench.core.state(), State::safe);
        EXPECT_EQ(bench.core.fault(), SafetyFault::force_not_finite);
    }
}

TEST(Safety, ForceIsClampedAndKeepsItsDirection) {
    Bench bench;
    bench.run();
    const double wanted[3] = {6.0, 0.0, -8.0};
    double sent[3];
    bench.core.gate(wanted, kT, sent);
    EXPECT_DOUBLE_EQ(sent[0], 2.4);
    EXPECT_DOUBLE_EQ(sent[1], 0.0);
    EXPECT_DOUBLE_EQ(sent[2], -3.2);
    EXPECT_EQ(bench.core.counts().forces_clamped, 1u);
    EXPECT_EQ(bench.core.state(), State::run);
}

TEST(Safety, ForceChangeIsLimitedAlongItsDirection) {
    SafetyLimits with = limits();
    with.max_slew_n_s = 500.0;  // 0.5 N per tick
    Bench bench(with);
    bench.run();
    const double wanted[3] = {3.0, 4.0, 0.0};
    double sent[3];
    for (int tick = 1; tick <= 4; ++tick) {
        bench.core.gate(wanted, kT, sent);
        EXPECT_NEAR(sent[0], 0.3 * tick, 1e-12);
        EXPECT_NEAR(sent[1], 0.4 * tick, 1e-12);
    }
    bench.core.gate(wanted, 0.1, sent);  // after a late tick: still one period's worth
    EXPECT_NEAR(std::hypot(sent[0], sent[1]), 2.5, 1e-12);
    EXPECT_EQ(bench.core.counts().forces_slewed, 5u);
}

TEST(Safety, EngagesSoftly) {
    SafetyLimits with = limits();
    with.engage_s = 0.1;
    Bench bench(with);
    bench.run();
    double last = 0.0;
    for (int tick = 1; tick <= 100; ++tick) {
        const double sent = bench.send(2.0);
        EXPECT_NEAR(sent, 2.0 * tick / 100.0, 1e-9);
        EXPECT_LT(sent - last, 0.0201);
        last = sent;
    }
    EXPECT_EQ(bench.send(2.0), 2.0);
}

TEST(Safety, TwentyOverrunsInARowAreSafeNineteenAreNot) {
    Bench bench;
    bench.run();
    for (unsigned i = 0; i + 1 < SafetyCore::kOverruns; ++i) {
        EXPECT_TRUE(bench.core.timing(i % 2 == 0 ? 501.0 : 100.0, i % 2 == 0 ? kT : 2.1 * kT));
    }
    EXPECT_EQ(bench.core.state(), State::degraded);
    EXPECT_FALSE(bench.core.timing(100.0, kT));
    for (unsigned i = 0; i < SafetyCore::kOverruns; ++i) (void)bench.core.timing(501.0, kT);
    EXPECT_EQ(bench.core.state(), State::safe);
    EXPECT_EQ(bench.core.fault(), SafetyFault::overruns);
    EXPECT_EQ(bench.core.counts().longest_overrun_run, 20u);
    EXPECT_EQ(bench.core.counts().over_budget, 30u);
    EXPECT_EQ(bench.core.counts().late_periods, 9u);
}

TEST(Safety, DegradedRunsAgainAfterCalm) {
    Bench bench;
    bench.run();
    (void)bench.core.timing(501.0, kT);
    EXPECT_EQ(bench.core.state(), State::degraded);
    for (int i = 0; i < 499; ++i) (void)bench.core.timing(1.0, kT);
    EXPECT_EQ(bench.core.state(), State::degraded);
    for (int i = 0; i < 2; ++i) (void)bench.core.timing(1.0, kT);
    EXPECT_EQ(bench.core.state(), State::run);
}

TEST(Safety, SafeIsLatchedAndKeepsItsFirstFault) {
    Bench bench;
    bench.run();
    (void)bench.send(kNan);
    for (int i = 0; i < 50; ++i) {
        (void)bench.read(0.0);
        (void)bench.core.timing(900.0, kT);
        EXPECT_EQ(bench.send(1.0), 0.0);
    }
    bench.core.arm();
    EXPECT_EQ(bench.core.state(), State::safe);
    EXPECT_EQ(bench.core.fault(), SafetyFault::force_not_finite);
}

// A wall of 1 N/mm that answers one tick late gives a mass that hits it more than it took.
double rebound_speed_mm_s(double passivity_damping_n_s_mm, SafetyCounts& counts) {
    SafetyLimits with = limits();
    with.encoder_mm = 0.0;
    with.passivity_damping_n_s_mm = passivity_damping_n_s_mm;
    Bench bench(with);
    bench.run();
    double x = 0.05, v = -60.0, felt_n = 0.0;
    for (int tick = 0; tick < 400 && !(x > 0.05 && v > 0.0); ++tick) {
        (void)bench.read(x);
        const double wanted = x < 0.0 ? -1.0 * x : 0.0;
        const double sent = bench.send(wanted);
        v += 1e3 * felt_n / 0.2 * kT;  // 0.2 kg
        x += v * kT;
        felt_n = sent;
    }
    counts = bench.core.counts();
    return v;
}

TEST(Safety, PassivityObserverSeesEnergyAndTheControllerTakesItBack) {
    SafetyCounts observed, controlled;
    const double free = rebound_speed_mm_s(0.0, observed);
    const double held = rebound_speed_mm_s(0.01, controlled);
    EXPECT_GT(free, 61.0);  // faster out than in
    EXPECT_GT(observed.most_energy_out_mj, 0.0);
    EXPECT_EQ(observed.passivity_ticks, 0u);  // it only observes
    EXPECT_LT(held, free - 0.3);
    EXPECT_GT(controlled.passivity_ticks, 0u);
    EXPECT_LT(controlled.most_energy_out_mj, observed.most_energy_out_mj);
}

TEST(Safety, SlowDeviceIsGrantedItsPeriods) {
    SafetyLimits with = limits();
    with.report_period_s = 0.02;
    Bench bench(with);
    bench.run();
    LinkReport silent;
    silent.fresh = false;
    const auto ticks_until = [&](State state) {
        int ticks = 0;
        for (; ticks < 1000 && bench.core.state() != state; ++ticks) bench.core.link(silent, kT);
        return ticks;
    };
    EXPECT_NEAR(ticks_until(State::degraded), 61, 1);  // more than three of its periods
    EXPECT_NEAR(61 + ticks_until(State::safe), 240, 2);
    EXPECT_EQ(bench.core.fault(), SafetyFault::no_report);
}

TEST(Safety, SilenceOfAnInputDeviceIsNoFault) {
    SafetyLimits with = limits();
    with.motors = false;
    Bench bench(with);
    bench.run();
    LinkReport silent;
    silent.fresh = false;
    for (int tick = 0; tick < 1000; ++tick) bench.core.link(silent, kT);
    EXPECT_EQ(bench.core.state(), State::run);
}

TEST(Safety, ClockOfTheDeviceCannotExcuseAJump) {
    Bench bench;
    bench.run();
    for (int i = 0; i < 3; ++i) {
        bench.core.link({}, kT);
        // Its clock says that ten seconds went by: 200 mm would be no speed.
        (void)bench.core.accept({{{200.0, 0.0, 0.0}}, bench.time_s + 10.0});
    }
    EXPECT_EQ(bench.core.fault(), SafetyFault::position_jump);
}

TEST(Overrun, GoesCoarserAtOnceAndFinerSlowly) {
    OverrunGovernor governor(4, kT);
    EXPECT_EQ(governor.update(false, 0), 0u);
    EXPECT_EQ(governor.update(true, 1), 2u);  // coarser than what was used
    EXPECT_EQ(governor.update(true, 2), 3u);
    EXPECT_EQ(governor.update(true, 3), 3u);  // there is nothing coarser
    EXPECT_EQ(governor.raised(), 2u);
    unsigned ticks = 0;
    while (governor.update(false, 3) > 0) ++ticks;
    EXPECT_EQ(ticks, 3u * 200u - 1u);
    OverrunGovernor single(1, kT);
    EXPECT_EQ(single.update(true, 0), 0u);
}

TEST(Stability, LimitIsThePassivityFormula) {
    EXPECT_DOUBLE_EQ(stability_limit_n_mm(0.005, 0.001, 1e-3, 1e-3), 4.0);
    EXPECT_DOUBLE_EQ(stability_limit_n_mm(0.005, 0.0, 1e-3, 0.0), 10.0);  // without delay: b > K T / 2
}

}  // namespace
}  // namespace hapticlod::station
