// A million random ticks and more against the invariants of docs/contact.md; `make soak` runs a hundred million.
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>

#include "tests/sanitized.hpp"
#include "tests/soak_run.hpp"

namespace hapticlod::test {
namespace {

#if defined(HAPTICLOD_SANITIZED)
constexpr std::uint64_t kShare = 40;  // of the ticks: sanitizers cost that much
#else
constexpr std::uint64_t kShare = 1;
#endif
constexpr std::uint64_t kRun = 10'000, kThinning = 256;

const SoakBodies& bodies() {
    static const SoakBodies made;
    return made;
}

// Runs of one kind without a fault, and that they were eventful: else their silence says little.
void soak(SoakKind kind, std::uint64_t wanted) {
    ASSERT_EQ(bodies().body.fault + bodies().plate.fault, "");
    SoakTally total;
    for (std::uint64_t seed = 0; total.ticks < wanted / kShare; ++seed) {
        const SoakOutcome outcome = soak_run(bodies(), kind, seed, kRun, kThinning);
        ASSERT_EQ(outcome.fault, "");
        total.add(outcome.tally);
    }
    if (total.ticks < 50'000) return;  // the sanitizers' share of some kinds is one body: too little to be eventful
    EXPECT_GT(total.contacts, total.ticks / 3);
    EXPECT_GT(total.switches, total.ticks / 500);
    EXPECT_GT(total.mapped, total.ticks / 1000);
    EXPECT_GT(total.faults, total.ticks / 5000);
    EXPECT_GT(total.distances, total.ticks / 10);
    EXPECT_GT(total.sides, total.ticks / kThinning / 4);
    EXPECT_GE(total.started_inside, 1u);
    // Balls that come back with a finer level may lie deeper than L reaches: then contact begins anew in front of it.
    EXPECT_LT(total.lost, total.ticks / (kind == SoakKind::nested_burr ? 1'000 : 10'000) + 1);
    EXPECT_LT(total.not_converged, total.ticks / 100);
    EXPECT_LT(total.held, total.ticks / 50);
}

TEST(Soak, Ball) { soak(SoakKind::ball, 1'000'000); }

TEST(Soak, RubbingBall) { soak(SoakKind::rubbing_ball, 100'000); }
TEST(Soak, Burr) { soak(SoakKind::burr, 100'000); }
TEST(Soak, NestedBurr) { soak(SoakKind::nested_burr, 100'000); }
TEST(Soak, RubbingBurr) { soak(SoakKind::rubbing_burr, 100'000); }

TEST(SoakRepeats, BitForBit) {
#ifdef HAPTICLOD_SANITIZED
    constexpr std::uint64_t kSeeds = 1;
#else
    constexpr std::uint64_t kSeeds = 4;
#endif
    for (const SoakKind kind : kSoakKinds)
        for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
            const SoakOutcome first = soak_run(bodies(), kind, seed, 2'000, kRun);
            const SoakOutcome second = soak_run(bodies(), kind, seed, 2'000, kRun);
            EXPECT_EQ(first.tally.ticks, second.tally.ticks);
            EXPECT_EQ(first.digest, second.digest) << name_of(kind) << ' ' << seed;
        }
}

// The judge itself: a right run with one number changed must be refused.
std::string tampered(SoakKind kind, std::uint64_t seed,
                     const std::function<void(TickRecord&, const SoakCase&)>& change) {
    const SoakCase c = soak_case(bodies(), kind, seed);
    std::vector<LevelView> views;
    for (const LevelStorage& level : c.body->levels) views.push_back(level.view());
    Renderer renderer;
    EXPECT_EQ(renderer.load(c.config, views, c.tool), "");
    SoakHand hand(c, seed);
    SoakCheck check(c, 1);
    TickRecord row;
    double last_s = 0.0;
    std::uint64_t quiet = 0;  // ticks in contact without a switch: no blend is left
    for (int t = 0; t < 20'000; ++t) {
        const SoakStep step = hand.next();
        const std::uint8_t level = row.level;
        renderer.tick(step.pose, step.time_s, row);
        quiet = row.contact != 0 && row.level == level && row.errors == 0 ? quiet + 1 : 0;
        const double period_s = step.time_s - last_s;
        last_s = step.time_s;
        const double aside_mm =
            std::max(std::abs(row.scp_mm[0] - c.config.origin_mm[0]), std::abs(row.scp_mm[1] - c.config.origin_mm[1]));
        if (quiet > 100 && std::abs(period_s - 1e-3) < 1e-9 && (!c.body->plate || aside_mm < 5.0)) {
            change(row, c);
            return check.judge(step, row);
        }
        if (const std::string fault = check.judge(step, row); !fault.empty()) return "too early: " + fault;
    }
    return "no contact";
}

// The SCP, so far (mm) along the force. The surface is on the other side.
void shift(TickRecord& row, double far_mm) {
    const double size = length({row.force_n[0], row.force_n[1], row.force_n[2]});
    for (int k = 0; k < 3; ++k) row.scp_mm[k] += row.force_n[k] / size * far_mm;
}

TEST(SoakJudge, RefusesWhatIsWrong) {
    for (std::uint64_t seed = 0; seed < std::max<std::uint64_t>(4 / kShare, 1); ++seed) {
        const auto after = [&](const auto& change) { return tampered(SoakKind::ball, seed, change); };
        EXPECT_EQ(after([](TickRecord&, const SoakCase&) {}), "");
        EXPECT_NE(after([](TickRecord& r, const SoakCase&) { r.torque_n_mm[1] = std::nan(""); }), "");
        EXPECT_NE(after([](TickRecord& r, const SoakCase&) { r.speed_mm_s = INFINITY; }), "");
        // The tick's own step may be against it.
        EXPECT_NE(after([](TickRecord& r, const SoakCase& c) { r.force_n[0] += 2.1e-3 * c.config.max_slew_n_s; }), "");
        EXPECT_NE(after([](TickRecord& r, const SoakCase& c) { r.force_n[0] = 1.5 * c.config.max_force_n; }), "");
        EXPECT_NE(after([](TickRecord& r, const SoakCase&) { shift(r, -3e-3); }).find("penetrates"), std::string::npos);
        EXPECT_NE(after([](TickRecord& r, const SoakCase&) { shift(r, -4.0); }), "");
    }
}

TEST(SoakJudge, BruteForceKnowsACube) {
    const SoakMesh mesh = thin_plate(1);
    const std::vector<Corners> box = corners_of(mesh.vertices, mesh.faces);
    EXPECT_NEAR(distance_to({3.0, 2.0, 1.15}, box), 1.0, 1e-6);
    EXPECT_NEAR(distance_to({13.0, 14.0, 0.0}, box), 5.0, 1e-6);
    EXPECT_NEAR(distance_to({1.0, 2.0, 0.05}, box), 0.1, 1e-6);
    EXPECT_NEAR(winding_number({1.0, 2.0, 0.05}, box), 1.0, 1e-9);
    EXPECT_NEAR(winding_number({1.0, 2.0, 0.16}, box), 0.0, 1e-9);
    EXPECT_EQ(crossings({1.0, 2.0, 0.05}, {1.3, 2.2, 5.0}, box), 1);
    EXPECT_EQ(crossings({1.0, 2.0, -4.0}, {1.3, 2.2, 5.0}, box), 2);
    EXPECT_EQ(crossings({1.0, 2.0, 4.0}, {1.3, 2.2, 5.0}, box), 0);
    const double half = std::sqrt(0.5), quarter[4] = {half, 0.0, 0.0, half};  // 90 degrees about z
    const Point y = turned(quarter, {1.0, 0.0, 0.0});
    EXPECT_NEAR(y[0], 0.0, 1e-12);
    EXPECT_NEAR(y[1], 1.0, 1e-12);
}

}  // namespace
}  // namespace hapticlod::test
