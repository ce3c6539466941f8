// The simulated hand and device against closed forms.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "station/simulated_device.hpp"
#include "station/stability.hpp"

namespace hapticlod::station {
namespace {

constexpr std::int64_t kTick_ns = 1'000'000;

HandPath still(double x_mm = 0.0) {
    return HandPath({{0.0, {x_mm, 0.0, 0.0}, {1.0, 0.0, 0.0, 0.0}}, {1.0, {x_mm, 0.0, 0.0}, {1.0, 0.0, 0.0, 0.0}}});
}

SimulatedBody exact_encoder() {
    SimulatedBody body;
    body.encoder_mm = 0.0;
    body.device_friction_n = 0.0;  // closed forms know none
    return body;
}

TEST(SimulatedDevice, ForceStepGivesTheDampedOscillation) {
    const SimulatedBody body = exact_encoder();
    SimulatedDevice device(still(), body);
    (void)device.read(0);
    const double force[3] = {1.0, 0.0, 0.0};
    device.write(0, force, true);
    // x'' + 2 z w x' + w^2 x = F/m, from rest.
    const double mass = body.hand_mass_kg + body.device_mass_kg;
    const double w = std::sqrt(body.hand_stiffness_n_mm * 1000.0 / mass);
    const double z = (body.hand_damping_n_s_mm + body.device_damping_n_s_mm) * 1000.0 / (2.0 * mass * w);
    const double wd = w * std::sqrt(1.0 - z * z);
    const double rest_mm = 1.0 / body.hand_stiffness_n_mm;
    for (int tick = 1; tick <= 400; ++tick) {
        const double read_mm = device.read(tick * kTick_ns).pose.position_mm[0];
        const double t = (tick - 1) * 1e-3;  // felt one period after it was written
        const double expected =
            rest_mm * (1.0 - std::exp(-z * w * t) * (std::cos(wd * t) + z * w / wd * std::sin(wd * t)));
        ASSERT_NEAR(read_mm, expected, 1e-7) << tick;
    }
    EXPECT_NEAR(device.position_mm()[0], rest_mm, 0.02);
}

TEST(SimulatedDevice, ResultDoesNotDependOnWhenItIsRead) {
    const double force[3] = {0.5, -0.2, 0.0};
    SimulatedDevice often(still(), exact_encoder()), late(still(), exact_encoder());
    for (SimulatedDevice* device : {&often, &late}) {
        (void)device->read(0);
        device->write(0, force, true);
    }
    for (int i = 1; i <= 300; ++i) (void)often.read(i * 123'457);
    (void)late.read(300 * 123'457);
    for (int axis = 0; axis < 3; ++axis) EXPECT_NEAR(often.position_mm()[axis], late.position_mm()[axis], 1e-8);
}

TEST(SimulatedDevice, PressedHandRestsWhereSpringsBalance) {
    // The hand wants to be 2 mm inside a wall of 1 N/mm: x = K_h d / (K_h + K) with the wall at 0.
    SimulatedDevice device(still(-2.0), exact_encoder());
    double x = 0.0;
    for (int tick = 0; tick < 2000; ++tick) {
        x = device.read(tick * kTick_ns).pose.position_mm[0];
        const double force[3] = {x < 0.0 ? -1.0 * x : 0.0, 0.0, 0.0};
        device.write(tick * kTick_ns, force, true);
    }
    EXPECT_NEAR(x, -2.0 * 0.5 / 1.5, 1e-6);
}

TEST(SimulatedDevice, EncoderRoundsToItsSteps) {
    SimulatedBody body;
    body.encoder_mm = 0.023;
    SimulatedDevice device(still(0.1), body);
    const double read_mm = device.read(0).pose.position_mm[0];
    EXPECT_NEAR(read_mm, 4 * 0.023, 1e-12);
    EXPECT_EQ(device.position_mm()[0], 0.1);
}

// A hand that lets go (no spring, no damping) of a wall: stable below half the limit, shaking well above it.
double wall_amplitude(double share_of_limit) {
    SimulatedBody body = exact_encoder();
    body.hand_stiffness_n_mm = 1e-4;  // gravity-like: just brings it back to the wall
    body.hand_damping_n_s_mm = 0.0;
    const double stiffness = share_of_limit * stability_limit_n_mm(body.device_damping_n_s_mm, 0.0, 1e-3, body.delay_s);
    SimulatedDevice device(still(-1.0), body);
    double most = 0.0;
    for (int tick = 0; tick < 4000; ++tick) {
        const double x = device.read(tick * kTick_ns).pose.position_mm[0];
        const double force[3] = {-stiffness * (x + 1.0) + (tick < 10 ? 0.5 : 0.0), 0.0, 0.0};  // two-sided wall, a kick
        device.write(tick * kTick_ns, force, true);
        if (tick >= 3000) most = std::max(most, std::abs(x + 1.0));
    }
    return most;
}

TEST(SimulatedDevice, ShakesAboveTheStabilityLimitAndRestsBelowOurs) {
    EXPECT_LT(wall_amplitude(kStiffnessShare), 1e-4);
    EXPECT_GT(wall_amplitude(2.0), 1.0);
}

// The same with everything a real device has: friction, encoder steps, delays both ways, and a hand that holds it.
double held_wall_amplitude(double share_of_limit, double read_delay_s) {
    SimulatedBody body;
    body.read_delay_s = read_delay_s;
    body.hand_stiffness_n_mm = 0.02;
    body.hand_damping_n_s_mm = 0.0;
    SimulatedDevice device(still(-1.0), body);
    const DeviceTraits traits = device.traits();
    const double limit = stability_limit_n_mm(traits.damping_n_s_mm, 0.0, 1e-3, traits.delay_s);
    double most = 0.0;
    for (int tick = 0; tick < 6000; ++tick) {
        const double x = device.read(tick * kTick_ns).pose.position_mm[0];
        const double force[3] = {-share_of_limit * limit * (x + 1.0) + (tick < 20 ? 2.0 : 0.0), 0.0, 0.0};
        device.write(tick * kTick_ns, force, true);
        if (tick >= 5000) most = std::max(most, std::abs(device.position_mm()[0] + 1.0));
    }
    return most;
}

TEST(SimulatedDevice, DelaysAndEncoderStepsLowerTheLimitAndHalfOfItHolds) {
    for (const double read_delay_s : {0.0, 1e-3, 3e-3}) {
        EXPECT_LT(held_wall_amplitude(kStiffnessShare, read_delay_s), 0.05) << read_delay_s;  // two encoder steps
        EXPECT_GT(held_wall_amplitude(2.0, read_delay_s), 0.5) << read_delay_s;
    }
}

TEST(SimulatedDevice, ReadingIsOfThePast) {
    SimulatedBody body = exact_encoder();
    SimulatedDevice now(still(), body);
    body.read_delay_s = 2e-3;
    SimulatedDevice late(still(), body);
    const double force[3] = {1.0, 0.0, 0.0};
    for (SimulatedDevice* device : {&now, &late}) {
        (void)device->read(0);
        device->write(0, force, true);
    }
    double before[3] = {0.0, 0.0, 0.0};
    for (int tick = 1; tick <= 50; ++tick) {
        const double x = now.read(tick * kTick_ns).pose.position_mm[0];
        const DeviceReading past = late.read(tick * kTick_ns);
        EXPECT_NEAR(past.pose.position_mm[0], before[tick % 2], 1e-9) << tick;
        EXPECT_NEAR(past.time_s, std::max(0, tick - 2) * 1e-3, 1e-12);
        before[tick % 2] = x;
    }
    EXPECT_DOUBLE_EQ(late.traits().delay_s, 3e-3);
}

TEST(SimulatedDevice, FrictionHoldsASmallForce) {
    SimulatedBody body = exact_encoder();
    body.hand_stiffness_n_mm = body.hand_damping_n_s_mm = 0.0;  // nobody holds it
    body.device_friction_n = 0.2;
    double moved[2];
    for (const double push_n : {0.1, 0.4}) {
        SimulatedDevice device(still(), body);
        for (int tick = 0; tick < 500; ++tick) {
            (void)device.read(tick * kTick_ns);
            const double force[3] = {push_n, 0.0, 0.0};
            device.write(tick * kTick_ns, force, true);
        }
        moved[push_n > 0.2 ? 1 : 0] = device.velocity_mm_s()[0];
    }
    EXPECT_LT(moved[0], 2.0);  // creeps within the speed in which friction turns over
    // Free of it: (0.4 - 0.2) N against 5 N s/m.
    EXPECT_NEAR(moved[1], 200.0 / 5.0, 0.5);
}

HandPath wave() {
    std::vector<MotionRow> rows(500);
    for (std::size_t i = 0; i < rows.size(); ++i) {
        const double t = 1.0 + 2e-3 * static_cast<double>(i);
        rows[i] = {t, {10.0 * std::sin(6.0 * t), 20.0 * t, 0.0}, {std::cos(t), std::sin(t), 0.0, 0.0}};
    }
    return HandPath(rows);
}

TEST(HandPath, IsSmoothThroughItsTurns) {
    const HandPath path = wave();
    constexpr double h = 1e-4;
    double fastest = 0.0;
    for (double t = 0.0; t < 3.5 * path.pass_s(); t += 0.97 * h) {
        const HandTarget now = path.at(t), next = path.at(t + h);
        double speed2 = 0.0;
        for (int axis = 0; axis < 3; ++axis) {
            const double moved = next.pose.position_mm[axis] - now.pose.position_mm[axis];
            const double v = 0.5 * (now.velocity_mm_s[axis] + next.velocity_mm_s[axis]);
            ASSERT_NEAR(moved / h, v, 0.1) << t;  // the velocity is that of the position, turns included
            ASSERT_LT(std::abs(next.velocity_mm_s[axis] - now.velocity_mm_s[axis]), 0.15) << t;
            speed2 += v * v;
        }
        fastest = std::max(fastest, std::sqrt(speed2));
    }
    EXPECT_NEAR(fastest, std::hypot(60.0, 20.0), 0.5);  // as fast as the motion, never faster
}

TEST(HandPath, StartsAtRestAndComesBackTheSameWay) {
    const HandPath path = wave();
    const HandTarget start = path.at(0.0);
    EXPECT_NEAR(start.pose.position_mm[1], 20.0, 1e-12);
    EXPECT_EQ(start.velocity_mm_s[1], 0.0);
    const HandTarget out = path.at(0.4), home = path.at(2.0 * path.pass_s() - 0.4);
    for (int axis = 0; axis < 3; ++axis) {
        EXPECT_NEAR(out.pose.position_mm[axis], home.pose.position_mm[axis], 1e-9);
        EXPECT_NEAR(out.velocity_mm_s[axis], -home.velocity_mm_s[axis], 1e-9);
    }
    EXPECT_NEAR(path.at(path.pass_s()).pose.position_mm[1], 20.0 * 1.998, 1e-9);
    double length2 = 0.0;
    for (const double q : path.at(0.777).pose.orientation) length2 += q * q;
    EXPECT_NEAR(length2, 1.0, 1e-12);
}

}  // namespace
}  // namespace hapticlod::station
