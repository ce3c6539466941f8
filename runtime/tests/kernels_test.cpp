// The SIMD kernels: scalar and AVX2 agree bit for bit, and both say what double precision says.
#include "core/kernels.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>

#include "core/occupancy.hpp"
#include "core/surface.hpp"
#include "core/triangle.hpp"

namespace hapticlod {
namespace {

// Random blocks: every fourth triangle a point, a segment, a sliver or far away.
TriBlock random_block(std::mt19937_64& random) {
    std::normal_distribution<float> normal;
    TriBlock block;
    for (int k = 0; k < 8; ++k) {
        for (auto& row : block.v) row[k] = normal(random);
        const auto kind = random() % 16;
        for (int c = 0; c < 3; ++c) {
            if (kind == 0) block.v[3 + c][k] = block.v[6 + c][k] = block.v[c][k];
            if (kind == 1) block.v[6 + c][k] = block.v[3 + c][k];
            if (kind == 2) block.v[6 + c][k] = block.v[c][k] + 0.5f * (block.v[3 + c][k] - block.v[c][k]);
            if (kind == 3) block.v[6 + c][k] = block.v[3 + c][k] + 1e-7f * normal(random);
        }
        if (kind == 4)
            for (auto& row : block.v) row[k] *= 1e4f;
        if (kind == 5)
            for (auto& row : block.v) row[k] *= 1e-20f;
        block.id[k] = k > 0 && kind == 6 ? kNoNeighbour : static_cast<std::uint32_t>(random());
    }
    return block;
}

TEST(Kernels, ScalarAndAvx2AreEqualBitForBit) {
    const Kernels &scalar = scalar_kernels(), &best = best_kernels();
    if (std::strcmp(scalar.name, best.name) == 0) GTEST_SKIP() << "this processor has no AVX2";
    std::mt19937_64 random(11);
    std::normal_distribution<float> normal;
    for (int round = 0; round < 20'000; ++round) {
        const TriBlock block = random_block(random);
        float shift[3], residual[3], move[3];
        for (int k = 0; k < 3; ++k) {
            shift[k] = round % 5 == 0 ? block.v[k][0] : normal(random);
            residual[k] = 1e-8f * normal(random);
            move[k] = 0.1f * normal(random);
        }
        EvalBlock said[2]{};
        const float least[2] = {scalar.eval(block, shift, residual, 0.5f, said[0]),
                                best.eval(block, shift, residual, 0.5f, said[1])};
        ASSERT_EQ(std::memcmp(&said[0], &said[1], sizeof said[0]), 0) << "eval, round " << round;
        ASSERT_EQ(std::memcmp(&least[0], &least[1], sizeof least[0]), 0) << "least, round " << round;
        ASSERT_TRUE(std::isfinite(least[0]));
        for (const float margin : {-0.1f, 0.0f, 0.3f})
            ASSERT_EQ(scalar.crossed(said[0], move, margin), best.crossed(said[1], move, margin))
                << "crossed, round " << round;
        ASSERT_EQ(scalar.granted(said[0], move), best.granted(said[1], move)) << "granted, round " << round;
    }
}

TEST(Kernels, BlockBoundsAreLowerBounds) {
    // Against the exact distances of the triangles, for eight balls at a time, by both builds.
    std::mt19937_64 random(3);
    std::normal_distribution<float> normal;
    double tightest = 1e300;
    for (int round = 0; round < 5'000; ++round) {
        const TriBlock block = random_block(random);
        const BlockBound bound = bound_of(block);
        BallPack balls;
        const float centre[3] = {normal(random), normal(random), normal(random)};
        for (int k = 0; k < 8; ++k) {
            balls.x[k] = normal(random), balls.y[k] = normal(random), balls.z[k] = normal(random);
            balls.kept[k] = 0.1f * static_cast<float>(k);
        }
        const float reach = std::abs(normal(random)), most = std::numeric_limits<float>::max();
        const std::uint32_t active = static_cast<std::uint32_t>(random()) & 0xffu;
        float least[2][8], low[2][8];
        std::uint32_t bits[2];
        for (int build = 0; build < 2; ++build) {
            std::fill_n(least[build], 8, most);
            (build == 0 ? scalar_kernels() : best_kernels())
                .near(&bound, 1, balls, centre, active, reach, least[build], low[build], &bits[build]);
        }
        ASSERT_EQ(std::memcmp(low[0], low[1], sizeof low[0]), 0);
        ASSERT_EQ(std::memcmp(least[0], least[1], sizeof least[0]), 0);
        ASSERT_EQ(bits[0], bits[1]);
        for (int k = 0; k < 8; ++k) {
            const Vec3 at = Vec3{centre[0], centre[1], centre[2]} + Vec3{balls.x[k], balls.y[k], balls.z[k]};
            double exact = 1e300, size = norm(at);
            for (int t = 0; t < 8; ++t) {
                const auto& v = block.v;
                const Triangle triangle{
                    {v[0][t], v[1][t], v[2][t]}, {v[3][t], v[4][t], v[5][t]}, {v[6][t], v[7][t], v[8][t]}};
                size = std::max({size, norm(triangle.a), norm(triangle.b), norm(triangle.c)});
                exact = std::min(exact, std::sqrt(closest_on_triangle(at, triangle).distance2));
            }
            ASSERT_LE(low[0][k], exact - balls.kept[k] + 3e-6 * size) << "round " << round;
            tightest = std::min(tightest, (exact - balls.kept[k] - low[0][k]) / size);
            EXPECT_EQ(bits[0] >> k & 1u, (active >> k & 1u) != 0 && low[0][k] <= reach ? 1u : 0u);
            EXPECT_EQ(least[0][k], low[0][k] > reach ? low[0][k] : most);
        }
    }
    EXPECT_LT(tightest, 0.05);  // and they say something
}

TEST(Kernels, WhatProvesOnePlaneIsTrue) {
    // The kernels of sole_plane.cpp and glide.cpp, eight blocks and one ball, by both builds: equal bit for bit; bounds
    // on the right side of what the corners and the exact distances say; lanes as double precision says, but for
    // rounding.
    const Kernels &scalar = scalar_kernels(), &best = best_kernels();
    std::mt19937_64 random(17);
    std::normal_distribution<float> normal;
    int inside = 0, above = 0, near = 0;
    for (int round = 0; round < 1'000; ++round) {
        TriBlock blocks[8];
        BlockBound bounds[8];
        for (int b = 0; b < 8; ++b) blocks[b] = random_block(random), bounds[b] = bound_of(blocks[b]);
        const float at[3] = {normal(random), normal(random), normal(random)}, zero[3] = {0.0f, 0.0f, 0.0f};
        const Vec3 place{at[0], at[1], at[2]}, any{normal(random), normal(random), normal(random)};
        const Vec3 unit = any * (1.0 / norm(any));
        const float n[3] = {static_cast<float>(unit.x), static_cast<float>(unit.y), static_cast<float>(unit.z)};
        float low[2][8], high[2][8], height2[2][8];
        scalar.near_one(bounds, 8, at, 0.2f, low[0]), best.near_one(bounds, 8, at, 0.2f, low[1]);
        scalar.highest(bounds, 8, at, n, high[0]), best.highest(bounds, 8, at, n, high[1]);
        ASSERT_EQ(std::memcmp(low[0], low[1], sizeof low[0]), 0);
        ASSERT_EQ(std::memcmp(high[0], high[1], sizeof high[0]), 0);
        // What comes near a way: no block may be missed whose corners do, and their hull is no nearer than its ball.
        const Vec3 along = round % 4 == 0 ? Vec3{} : Vec3{normal(random), normal(random), normal(random)} * 0.5;
        const float way[3] = {static_cast<float>(along.x), static_cast<float>(along.y), static_cast<float>(along.z)};
        const float inverse2 = round % 4 == 0 ? 0.0f : static_cast<float>(1.0 / norm2(along));
        float apart2[2][8];
        std::uint32_t beside[2] = {};
        scalar.beside(bounds, 8, at, way, inverse2, 0.2f, apart2[0], &beside[0]);
        best.beside(bounds, 8, at, way, inverse2, 0.2f, apart2[1], &beside[1]);
        ASSERT_EQ(beside[0], beside[1]);
        ASSERT_EQ(std::memcmp(apart2[0], apart2[1], sizeof apart2[0]), 0);
        for (int b = 0; b < 8; ++b) {
            const Vec3 middle{bounds[b].x, bounds[b].y, bounds[b].z};
            const double size = std::max(norm(middle), norm(place));
            ASSERT_NEAR(double{apart2[0][b]}, norm2(middle - place), 1e-5 * size * size);
            const double gap =
                norm(middle - closest_on_segment(middle, place, place + along)) - double{bounds[b].radius};
            if (std::abs(gap - 0.2) > 1e-5 * size) {
                ASSERT_EQ(beside[0] >> b & 1u, gap < 0.2 ? 1u : 0u);
            }
            near += gap < 0.2;
        }
        for (int b = 0; b < 8; ++b) {
            const auto& v = blocks[b].v;
            const std::uint32_t facing = scalar.facing(blocks[b], at, zero, height2[0]);
            ASSERT_EQ(facing, best.facing(blocks[b], at, zero, height2[1]));
            ASSERT_EQ(std::memcmp(height2[0], height2[1], sizeof height2[0]), 0);
            const std::uint32_t rising = scalar.above(blocks[b], at, zero, n, 0.1f);
            ASSERT_EQ(rising, best.above(blocks[b], at, zero, n, 0.1f));
            double exact = 1e300, highest = -1e300, size = norm(place);
            for (int t = 0; t < 8; ++t) {
                const Triangle triangle{
                    {v[0][t], v[1][t], v[2][t]}, {v[3][t], v[4][t], v[5][t]}, {v[6][t], v[7][t], v[8][t]}};
                const double own = std::max({norm(triangle.a), norm(triangle.b), norm(triangle.c), norm(place)});
                size = std::max(size, own);
                const ClosestPoint c = closest_on_triangle(place, triangle);
                exact = std::min(exact, std::sqrt(c.distance2));
                const double rise = std::max(
                    {dot(unit, triangle.a - place), dot(unit, triangle.b - place), dot(unit, triangle.c - place)});
                highest = std::max(highest, rise);
                if (std::abs(rise - 0.1) > 1e-5 * own) {
                    ASSERT_EQ(rising >> t & 1u, rise > 0.1 ? 1u : 0u);
                }
                above += rise > 0.1;
                // A sliver's inside is a matter of rounding.
                const Vec3 u = triangle.b - triangle.a, w = triangle.c - triangle.a;
                const double area2 = norm2(cross(u, w));
                if (!(area2 > 1e-4 * norm2(u) * norm2(w)) || own > 10.0) continue;
                const std::array<double, 3> weight = weights_on(triangle, cross(u, w), area2, place);
                const double least = std::min({weight[0], weight[1], weight[2]});
                if (std::abs(least) < 1e-3) continue;
                ASSERT_EQ(facing >> t & 1u, least > 0.0 ? 1u : 0u);
                if (least > 0.0) {
                    ASSERT_NEAR(std::sqrt(height2[0][t]), std::sqrt(c.distance2), 1e-4 * own);
                }
                inside += least > 0.0;
            }
            ASSERT_LE(low[0][b], exact - 0.2 + 3e-6 * size) << "round " << round;
            ASSERT_GE(high[0][b], highest - 3e-6 * size) << "round " << round;
        }
    }
    EXPECT_GT(inside, 1'000);
    EXPECT_GT(above, 1'000);
    EXPECT_GT(near, 100);
    EXPECT_LT(near, 7'900);
}

TEST(Kernels, ClearanceIsTheDistance) {
    // An independent distance: the least over a fine barycentric grid, which can only be larger.
    const Kernels& best = best_kernels();
    std::mt19937_64 random(5);
    std::normal_distribution<float> normal;
    for (int round = 0; round < 40; ++round) {
        const TriBlock block = random_block(random);
        const float zero[3] = {0, 0, 0}, p[3] = {normal(random), normal(random), normal(random)};
        EvalBlock said{};
        best.eval(block, p, zero, 0.0f, said);
        for (int k = 0; k < 8; ++k) {
            double nearest = 1e300, extent = 0.0;
            constexpr int n = 100;
            for (int i = 0; i <= n; ++i)
                for (int j = 0; i + j <= n; ++j) {
                    double d2 = 0.0;
                    for (int c = 0; c < 3; ++c) {
                        const double a = block.v[c][k], u = block.v[3 + c][k] - a, w = block.v[6 + c][k] - a;
                        const double d = a + u * i / n + w * j / n - p[c];
                        d2 += d * d;
                        extent = std::max({extent, std::abs(u), std::abs(w)});
                    }
                    nearest = std::min(nearest, std::sqrt(d2));
                }
            const double rounding = 1e-5 * (1.0 + nearest + extent);
            EXPECT_LE(said.clearance[k], nearest + rounding);
            EXPECT_GE(said.clearance[k], nearest - 2.0 * extent / n - rounding);
        }
    }
}

}  // namespace
}  // namespace hapticlod
