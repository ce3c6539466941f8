// Where a segment meets a triangle: against points that are chosen on or beside it.
#include <gtest/gtest.h>

#include <random>

#include "core/inside.hpp"

namespace hapticlod {
namespace {

TEST(SegmentHit, FindsChosenPointsAndNoOthers) {
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> unit(0.0, 1.0), wide(-1.0, 1.0);
    const auto any = [&] { return Vec3{wide(random), wide(random), wide(random)}; };
    int hits = 0;
    for (int round = 0; round < 20'000; ++round) {
        const Triangle t{any(), any(), any()};
        const Vec3 ab = t.b - t.a, ac = t.c - t.a, n = cross(ab, ac);
        // A point of the triangle's plane, inside it or not, and a segment through it or stopping short of it.
        const double v = 1.5 * unit(random) - 0.25, w = 1.5 * unit(random) - 0.25;
        const Vec3 on = t.a + ab * v + ac * w, d = any();
        if (norm(n) < 0.05 || std::abs(dot(d, n)) < 0.02) continue;
        const double at = 1.5 * unit(random) - 0.25;
        const double margin = std::min({v, w, 1.0 - v - w, at, 1.0 - at});
        if (std::abs(margin) < 1e-6) continue;
        const double found = segment_hit(on - d * at, on + d * (1.0 - at), t);
        if (margin > 0.0) {
            ++hits;
            ASSERT_NEAR(found, at, 1e-9) << "round " << round;
        } else {
            ASSERT_EQ(found, 2.0) << "round " << round;
        }
    }
    EXPECT_GT(hits, 1'000);
}

}  // namespace
}  // namespace hapticlod
