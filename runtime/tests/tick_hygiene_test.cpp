// What a tick must never do, counted: allocate, lock, write. And what it must always do: give the same bits twice, give
// the caller's floating-point mode back.
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

#include "core/renderer.hpp"
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

// Runs `work` while the interposer counts; under sanitizers, whose allocations they would be, it only runs.
template <typename Work>
void expect_only_arithmetic(const Work& work) {
#if defined(HAPTICLOD_INTERPOSED)
    allocations = locks = writes = 0;
    watching = true;
#endif
    work();
#if defined(HAPTICLOD_INTERPOSED)
    watching = false;
    EXPECT_EQ(allocations, 0);
    EXPECT_EQ(locks, 0);
    EXPECT_EQ(writes, 0);
#endif
}

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

#if defined(HAPTICLOD_SANITIZED)
constexpr std::size_t kTicks = 2'000;
#else
constexpr std::size_t kTicks = 10'000;
#endif

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
    expect_only_arithmetic([&] {
        for (std::size_t t = 0; t < kTicks; ++t) {
            if (t == kTicks / 2) scene.renderer.reset();
            scene.renderer.set_coarsest_floor(t % 1000 > 900 ? 2 : 0);
            scene.renderer.tick(steps[t].pose, steps[t].time_s, rows[t]);
        }
    });
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
    EXPECT_GT(switches, static_cast<int>(kTicks / 200));
    EXPECT_GT(contacts, static_cast<int>(kTicks / 10));
    EXPECT_GT(mapped, static_cast<int>(kTicks / 1000));
    EXPECT_GT(inside, 0);
    EXPECT_GT(faults, static_cast<int>(kTicks / 500));
}

TEST(TickHygieneDistance, NothingButArithmetic) {
    for (const bool one_point : {true, false}) {
        Scene scene(Mapping::two_sided, one_point, false, Policy::distance);
        const std::vector<Step> steps = journey(kTicks / 4);
        std::vector<TickRecord> rows(steps.size());
        expect_only_arithmetic([&] {
            for (std::size_t t = 0; t < steps.size(); ++t) scene.renderer.tick(steps[t].pose, steps[t].time_s, rows[t]);
        });
        int switches = 0;
        for (std::size_t t = 1; t < rows.size(); ++t) {
            switches += rows[t].level != rows[t - 1].level;
            for (const double f : rows[t].force_n) ASSERT_TRUE(std::isfinite(f));
        }
        EXPECT_GT(switches, static_cast<int>(steps.size() / 50));
    }
}

TEST_P(TickHygiene, TwoRunsGiveTheSameBits) {
    const std::vector<Step> steps = journey(2000);
    std::vector<TickRecord> rows[2];
    for (std::vector<TickRecord>& run : rows) {
        Scene scene(std::get<0>(GetParam()), std::get<1>(GetParam()), std::get<2>(GetParam()));
        run.resize(steps.size());
        // Whatever a record held before.
        std::memset(static_cast<void*>(run.data()), &run == &rows[0] ? 0 : 0xa5, run.size() * sizeof(TickRecord));
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

}  // namespace
}  // namespace hapticlod
