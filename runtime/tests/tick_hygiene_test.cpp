// What a tick must never do, counted: allocate, lock, write. And what it must always do: give the same bits twice, give
// the caller's floating-point mode back, and agree between scalar and AVX2 kernels.
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <numbers>
#include <random>
#include <tuple>
#include <vector>

#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

#include "core/kernels.hpp"
#include "core/occupancy.hpp"
#include "core/renderer.hpp"
#include "core/surface.hpp"
#include "core/triangle.hpp"
#include "tests/sanitized.hpp"

#if !defined(HAPTICLOD_SANITIZED) && defined(__GLIBC__)
#define HAPTICLOD_INTERPOSED 1
#include <pthread.h>
#include <sys/types.h>

// The program's own definitions come before libc's and libstdc++'s: operator new ends in malloc here.
namespace {
std::atomic<bool> watching{false};
std::atomic<int> allocations{0}, locks{0}, writes{0};
void note(std::atomic<int>& count) {
    if (watching.load(std::memory_order_relaxed)) count.fetch_add(1, std::memory_order_relaxed);
}
}  // namespace

extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_realloc(void*, std::size_t);
void __libc_free(void*);
long syscall(long, ...);

void* malloc(std::size_t size) {
    note(allocations);
    return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
    note(allocations);
    return __libc_calloc(count, size);
}
void* realloc(void* p, std::size_t size) {
    note(allocations);
    return __libc_realloc(p, size);
}
void free(void* p) {
    note(allocations);
    __libc_free(p);
}
// glibc keeps the plain name for its own callers too; only the count is wanted, the lock itself through trylock.
int pthread_mutex_lock(pthread_mutex_t* mutex) {
    note(locks);
    int rc;
    while ((rc = pthread_mutex_trylock(mutex)) == 16 /* EBUSY */) {
    }
    return rc;
}
ssize_t write(int fd, const void* bytes, std::size_t size) {
    note(writes);
    return syscall(1 /* SYS_write */, fd, bytes, size);
}
}
#endif

namespace hapticlod {
namespace {

struct Mesh {
    std::vector<float> vertices;
    std::vector<std::uint32_t> faces;
};

// Closed sphere of rings x sectors.
Mesh globe(double radius_mm, std::uint32_t rings, std::uint32_t sectors) {
    Mesh m;
    const auto vertex = [&](double x, double y, double z) {
        for (const double v : {x, y, z}) m.vertices.push_back(static_cast<float>(radius_mm * v));
    };
    vertex(0.0, 0.0, 1.0);
    for (std::uint32_t i = 1; i < rings; ++i)
        for (std::uint32_t j = 0; j < sectors; ++j) {
            const double a = std::numbers::pi * i / rings, b = 2.0 * std::numbers::pi * j / sectors;
            vertex(std::sin(a) * std::cos(b), std::sin(a) * std::sin(b), std::cos(a));
        }
    vertex(0.0, 0.0, -1.0);
    const std::uint32_t last = 1 + (rings - 1) * sectors;
    const auto at = [&](std::uint32_t ring, std::uint32_t j) { return 1 + (ring - 1) * sectors + j % sectors; };
    const auto face = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
        m.faces.insert(m.faces.end(), {a, b, c});
    };
    for (std::uint32_t j = 0; j < sectors; ++j) {
        face(0, at(1, j), at(1, j + 1));
        for (std::uint32_t i = 1; i + 1 < rings; ++i) {
            face(at(i, j), at(i + 1, j), at(i + 1, j + 1));
            face(at(i, j), at(i + 1, j + 1), at(i, j + 1));
        }
        face(last, at(rings - 1, j + 1), at(rings - 1, j));
    }
    return m;
}

struct Step {
    Pose pose;
    double time_s;
};

// Starts inside, leaves, and goes around and through the globe at 0 to 1 m/s, turning; some ticks are faulty.
std::vector<Step> journey(std::size_t ticks) {
    std::mt19937_64 random(7);
    std::normal_distribution<double> normal;
    std::vector<Step> steps(ticks);
    double x[3] = {0.3, 0.2, 9.5}, v[3] = {}, q[4] = {1, 0, 0, 0};
    for (std::size_t t = 0; t < ticks; ++t) {
        double size = 0.0;
        for (int k = 0; k < 3; ++k) {
            v[k] += 0.08 * normal(random) - 0.03 * v[k] -
                    2e-4 * x[k] * (x[0] * x[0] + x[1] * x[1] + x[2] * x[2] - 100.0) / 20.0;
            v[k] = std::clamp(v[k], -0.6, 0.6);
            x[k] += v[k];
        }
        for (double& c : q) c += 0.01 * normal(random), size += c * c;
        for (double& c : q) c /= std::sqrt(size);
        Pose& p = steps[t].pose;
        for (int k = 0; k < 3; ++k) p.position_mm[k] = x[k];
        for (int k = 0; k < 4; ++k) p.orientation[k] = q[k];
        steps[t].time_s = 1e-3 * static_cast<double>(t);
        if (t % 997 == 500) p.position_mm[1] = std::numeric_limits<double>::quiet_NaN();
        if (t % 1999 == 700) p.position_mm[0] += 1e4;
        if (t % 499 == 100) steps[t].time_s = 0.0;
    }
    return steps;
}

// Three levels of one sphere under a tool of 20 balls.
struct Scene {
    LevelStorage levels[3];
    Renderer renderer;

    Scene(Mapping mapping, bool one_point, bool materials, Policy policy = Policy::velocity) {
        const Mesh meshes[3] = {globe(10.0, 48, 96), globe(9.97, 32, 64), globe(10.02, 20, 40)};
        std::vector<LevelView> views;
        for (int k = 0; k < 3; ++k) {
            EXPECT_EQ(levels[k].build(meshes[k].vertices, meshes[k].faces, 0.8), "");
            if (materials) {
                std::vector<Material> made(meshes[k].vertices.size() / 3);
                for (std::size_t i = 0; i < made.size(); ++i) {
                    const float part = static_cast<float>(i % 7) / 7.0f;
                    made[i] = {0.3f + part, 0.1f + 0.4f * part, 0.3f * part};
                    if (i % 5 == 0) made[i] = {kAsStation, kAsStation, kAsStation};
                }
                EXPECT_EQ(levels[k].set_materials(made), "");
            }
            views.push_back(levels[k].view());
        }
        ConfigData c{};
        c.version = kConfigVersion;
        c.level_count = 3;
        c.mapping = static_cast<std::uint32_t>(mapping);
        c.shading = 1;
        c.loop_hz = 1000.0;
        c.stiffness_n_mm = 1.0;
        c.damping_n_s_mm = 1e-3;
        c.friction_static = 0.3, c.friction_dynamic = 0.2;
        c.filter_hz = 30.0, c.hysteresis = 0.1, c.dwell_s = 0.002;
        c.l_in_mm = c.l_out_mm = c.closest_bound_mm = 0.5;
        c.blend_s = 0.02;
        c.max_force_n = 3.0, c.max_slew_n_s = 2000.0, c.engage_s = 0.05;
        c.policy = static_cast<std::uint32_t>(policy);
        const bool by_speed = policy == Policy::velocity;
        c.speeds_mm_s[0] = by_speed ? 150.0 : 0.1, c.speeds_mm_s[1] = by_speed ? 300.0 : 0.5;
        for (int k = 0; k < 3; ++k) c.cell_mm[k] = 0.8, c.balls[k] = 20 - 4 * static_cast<std::uint32_t>(k);
        std::mt19937_64 random(3);
        std::normal_distribution<double> normal;
        std::uniform_real_distribution<double> radius(0.0, 0.5);
        std::vector<BallData> tool(one_point ? 1 : 20, BallData{});
        if (!one_point)
            for (BallData& b : tool)
                b = {{0.6 * normal(random), 0.6 * normal(random), 0.6 * normal(random)}, radius(random)};
        EXPECT_EQ(renderer.load(c, views, tool), "");
    }
};

#if defined(HAPTICLOD_INTERPOSED)
TEST(Watch, CountsWhatItIsMeantToCount) {
    allocations = locks = writes = 0;
    pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
    watching = true;
    std::vector<int> grown(100);
    pthread_mutex_lock(&mutex);
    const ssize_t written = write(1, "", 0);
    watching = false;
    pthread_mutex_unlock(&mutex);
    EXPECT_EQ(grown.size(), 100u);
    EXPECT_EQ(written, 0);
    EXPECT_EQ(allocations, 1);
    EXPECT_EQ(locks, 1);
    EXPECT_EQ(writes, 1);
}
#endif

class TickHygiene : public testing::TestWithParam<std::tuple<Mapping, bool, bool>> {};

constexpr std::size_t kTicks = 10'000;

TEST_P(TickHygiene, NothingButArithmetic) {
    Scene scene(std::get<0>(GetParam()), std::get<1>(GetParam()), std::get<2>(GetParam()));
    const std::vector<Step> steps = journey(kTicks);
    std::vector<TickRecord> rows(kTicks);
#if defined(__SSE2__)
    const unsigned mode = _mm_getcsr();
    _mm_setcsr(0x1f80u | 0x2000u);  // another rounding than the default, nothing flushed
    const unsigned set = _mm_getcsr();
    scene.renderer.tick(steps[0].pose, steps[0].time_s, rows[0]);
    EXPECT_EQ(_mm_getcsr() & ~0x3fu, set & ~0x3fu);  // but for the sticky flags
    _mm_setcsr(mode);
    scene.renderer.reset();
#endif
#if defined(HAPTICLOD_INTERPOSED)
    allocations = locks = writes = 0;
    watching = true;
#endif
    for (std::size_t t = 0; t < kTicks; ++t) {
        if (t == kTicks / 2) scene.renderer.reset();
        scene.renderer.set_coarsest_floor(t % 1000 > 900 ? 2 : 0);
        scene.renderer.tick(steps[t].pose, steps[t].time_s, rows[t]);
    }
#if defined(HAPTICLOD_INTERPOSED)
    watching = false;
    EXPECT_EQ(allocations, 0);
    EXPECT_EQ(locks, 0);
    EXPECT_EQ(writes, 0);
#endif
    // The journey must have been eventful, or the counts say little.
    int switches = 0, contacts = 0, mapped = 0, inside = 0, faults = 0;
    for (std::size_t t = 1; t < kTicks; ++t) {
        switches += rows[t].level != rows[t - 1].level;
        contacts += rows[t].contact;
        mapped += rows[t].mapping != 0;
        inside += (rows[t].errors & kErrStartInside) != 0;
        faults += (rows[t].errors & (kErrHipNotFinite | kErrHipJump | kErrPeriod)) != 0;
        for (const double f : rows[t].force_n) ASSERT_TRUE(std::isfinite(f));
    }
    inside += (rows[0].errors & kErrStartInside) != 0;
    EXPECT_GT(switches, 50);
    EXPECT_GT(contacts, 1000);
    EXPECT_GT(mapped, 10);
    EXPECT_GT(inside, 0);
    EXPECT_GT(faults, 20);
}

TEST(TickHygieneDistance, NothingButArithmetic) {
    for (const bool one_point : {true, false}) {
        Scene scene(Mapping::two_sided, one_point, false, Policy::distance);
        const std::vector<Step> steps = journey(kTicks / 4);
        std::vector<TickRecord> rows(steps.size());
#if defined(HAPTICLOD_INTERPOSED)
        allocations = locks = writes = 0;
        watching = true;
#endif
        for (std::size_t t = 0; t < steps.size(); ++t) scene.renderer.tick(steps[t].pose, steps[t].time_s, rows[t]);
#if defined(HAPTICLOD_INTERPOSED)
        watching = false;
        EXPECT_EQ(allocations, 0);
        EXPECT_EQ(locks, 0);
        EXPECT_EQ(writes, 0);
#endif
        int switches = 0;
        for (std::size_t t = 1; t < rows.size(); ++t) {
            switches += rows[t].level != rows[t - 1].level;
            for (const double f : rows[t].force_n) ASSERT_TRUE(std::isfinite(f));
        }
        EXPECT_GT(switches, 50);
    }
}

TEST_P(TickHygiene, TwoRunsGiveTheSameBits) {
    const std::vector<Step> steps = journey(2000);
    std::vector<TickRecord> rows[2];
    for (std::vector<TickRecord>& run : rows) {
        Scene scene(std::get<0>(GetParam()), std::get<1>(GetParam()), std::get<2>(GetParam()));
        run.resize(steps.size());
        for (std::size_t t = 0; t < steps.size(); ++t) scene.renderer.tick(steps[t].pose, steps[t].time_s, run[t]);
    }
    EXPECT_EQ(std::memcmp(rows[0].data(), rows[1].data(), rows[0].size() * sizeof(TickRecord)), 0);
}

TEST(TickHygieneReset, ForgetsEverything) {
    const std::vector<Step> steps = journey(2000);
    Scene scene(Mapping::two_sided, false, true);
    std::vector<TickRecord> rows[2];
    for (std::vector<TickRecord>& run : rows) {
        run.resize(steps.size());
        scene.renderer.reset();
        for (std::size_t t = 0; t < steps.size(); ++t) scene.renderer.tick(steps[t].pose, steps[t].time_s, run[t]);
    }
    for (std::size_t t = 0; t < steps.size(); ++t)
        ASSERT_EQ(std::memcmp(&rows[0][t].force_n, &rows[1][t].force_n, sizeof rows[0][t].force_n), 0) << "tick " << t;
}

INSTANTIATE_TEST_SUITE_P(All, TickHygiene,
                         testing::Combine(testing::Values(Mapping::paper, Mapping::two_sided), testing::Bool(),
                                          testing::Bool()));

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
    // The kernels of sole_plane.cpp, eight blocks and one ball, by both builds: equal bit for bit; bounds on the right
    // side of what the corners and the exact distances say; lanes as double precision says, but for rounding.
    const Kernels &scalar = scalar_kernels(), &best = best_kernels();
    std::mt19937_64 random(17);
    std::normal_distribution<float> normal;
    int inside = 0, above = 0;
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
