// Several parts in one loop: held against the merged mesh, and hidden, shown and exchanged while the tool moves.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <ctime>
#include <new>

#include "tests/sanitized.hpp"
#include "tests/scene_shapes.hpp"

#ifndef HAPTICLOD_SANITIZED
namespace {
std::atomic<bool> watching{false};
std::atomic<int> allocations{0};
void* counted(std::size_t size) {
    if (watching.load(std::memory_order_relaxed)) allocations.fetch_add(1, std::memory_order_relaxed);
    void* made = std::malloc(size == 0 ? 1 : size);
    if (made == nullptr) std::abort();
    return made;
}
void freed(void* p) {
    if (watching.load(std::memory_order_relaxed)) allocations.fetch_add(1, std::memory_order_relaxed);
    std::free(p);
}
}  // namespace
void* operator new(std::size_t size) { return counted(size); }
void* operator new[](std::size_t size) { return counted(size); }
void operator delete(void* p) noexcept { freed(p); }
void operator delete[](void* p) noexcept { freed(p); }
void operator delete(void* p, std::size_t) noexcept { freed(p); }
void operator delete[](void* p, std::size_t) noexcept { freed(p); }
#endif

namespace hapticlod::test {
namespace {

const std::vector<ScenePart>& heap() {
    static const std::vector<ScenePart> parts = heap_of_parts();
    return parts;
}

// Of this thread alone: other programs do not count.
double thread_us() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e6 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_nsec);
}

Pose pose_at(const ConfigData& config, const Point& p) {
    Pose pose{};
    pose.orientation[0] = 1.0;
    for (std::size_t k = 0; k < 3; ++k) pose.position_mm[k] = p[k] + config.origin_mm[k];
    return pose;
}

Point scp_of(const TickRecord& row, const ConfigData& config) {
    return {row.scp_mm[0] - config.origin_mm[0], row.scp_mm[1] - config.origin_mm[1],
            row.scp_mm[2] - config.origin_mm[2]};
}

// Of all balls of the tool to all parts that are to be seen, less the radius; negative inside a part.
double clearance(const Point& scp, const std::vector<BallData>& tool,
                 std::span<const std::vector<Corners>* const> seen) {
    double least = 1e300;
    for (const BallData& ball : tool) {
        const Point at = scp + Point{ball.centre_mm[0], ball.centre_mm[1], ball.centre_mm[2]};
        for (const std::vector<Corners>* part : seen) {
            double d = distance_to(at, *part);
            if (d > 1e-3 && winding_number(at, *part) > 0.5) d = -d;
            least = std::min(least, d - ball.radius_mm);
        }
    }
    return least;
}

struct Compared {
    std::size_t ticks = 0, contacts = 0, apart = 0, on_two = 0, switches = 0, unfinished = 0, trapped = 0;
    double farthest_mm = 0.0;
};

// The scene and the merged mesh under one hand.
Compared compare(const std::vector<BallData>& tool, std::uint32_t level_count, std::uint64_t seed, std::size_t ticks) {
    ConfigData config = heap_config(level_count, tool.size());
    config.blend_s = 0.0;  // places as they are, not as they are rendered
    const std::vector<SoakMesh> meshes = merged(heap(), level_count);
    std::vector<LevelStorage> levels(level_count);
    std::vector<LevelView> views;
    for (std::uint32_t k = 0; k < level_count; ++k) {
        EXPECT_EQ(levels[k].build(meshes[k].vertices, meshes[k].faces, 1.0), "");
        views.push_back(levels[k].view());
    }
    // Parts with as many levels as the scene shows.
    std::vector<std::unique_ptr<Part>> cut;
    std::vector<const Part*> parts;
    for (const ScenePart& p : heap()) {
        std::vector<LevelView> own;
        for (std::size_t k = 0; k < std::min<std::size_t>(level_count, p.levels.size()); ++k)
            own.push_back(p.levels[k].view());
        parts.push_back(cut.emplace_back(std::make_unique<Part>(own)).get());
    }
    Renderer scene, whole;
    EXPECT_EQ(scene.load_scene(config, parts, ~0ull, tool), "");
    EXPECT_EQ(whole.load(config, views, tool), "");
    HeapHand hand(seed);
    Compared out;
    TickRecord a, b;
    std::uint8_t level = 0;
    bool lost = false;
    for (std::size_t t = 0; t < ticks; ++t) {
        const Point hip = hand.next();
        const Pose pose = pose_at(config, hip);
        if (lost && length(hip) > 23.0) scene.reset(), whole.reset(), lost = false;
        const double time_s = 1e-3 * static_cast<double>(t);
        scene.tick(pose, time_s, a);
        whole.tick(pose, time_s, b);
        const double d = length(scp_of(a, config) - scp_of(b, config));
        if (lost) continue;
        if (d > 1e-3 && level_count > 1) {
            // A merged mesh has no inside where its parts overlap: a switch may leave a point behind one of them.
            std::vector<const std::vector<Corners>*> seen;
            for (const ScenePart& p : heap()) seen.push_back(&p.at(a.level));
            EXPECT_GT(clearance(scp_of(a, config), tool, seen), -1e-3);
            lost = clearance(scp_of(b, config), tool, seen) < -1e-3;
            out.trapped += lost;
            if (lost) continue;
        }
        ++out.ticks;
        out.contacts += a.contact;
        out.switches += a.level != level;
        level = a.level;
        out.on_two += std::popcount(scene.touched()) > 1;
        // Cut short after 64 iterations, a tick is somewhere on its way.
        const bool unfinished = ((a.errors | b.errors) & kErrNotConverged) != 0;
        out.unfinished += unfinished;
        out.apart += !unfinished && d > 1e-3;
        if (!unfinished) out.farthest_mm = std::max(out.farthest_mm, d);
        EXPECT_EQ(a.level, b.level);
    }
    return out;
}

#ifdef HAPTICLOD_SANITIZED
constexpr std::size_t kTicks = 10'000, kChanging = 5'000;
#else
constexpr std::size_t kTicks = 20'000, kChanging = kTicks;
#endif

void expect_same(const std::vector<BallData>& tool, std::uint32_t levels, std::uint64_t seed) {
    for (const ScenePart& p : heap()) ASSERT_EQ(p.fault, "");
    const Compared c = compare(tool, levels, seed, kTicks);
    std::printf(
        "[scene] %zu ticks, %zu in contact, %zu on two parts, %zu switches, %zu unfinished, %zu apart, "
        "farthest %.3g mm, merged mesh trapped %zu times\n",
        c.ticks, c.contacts, c.on_two, c.switches, c.unfinished, c.apart, c.farthest_mm, c.trapped);
    EXPECT_GT(c.contacts, c.ticks / 4);
    EXPECT_GT(c.on_two, c.ticks / 200);
    // Where two ways out are as near, rounding chooses: for one tick the two may lie on either side of an edge.
    EXPECT_LE(c.apart, c.ticks / 10'000);
    EXPECT_LT(c.farthest_mm, 0.2);
    EXPECT_LE(c.unfinished, c.ticks / 1000);
    EXPECT_GE(c.switches, levels > 1 ? 5u : 0u);
}

TEST(SceneIsTheMergedMesh, Point) { expect_same(ball_of(0.0), 1, 1); }
TEST(SceneIsTheMergedMesh, Ball) { expect_same(ball_of(0.8), 1, 2); }
TEST(SceneIsTheMergedMesh, Burr) { expect_same(small_burr(), 1, 3); }
TEST(SceneIsTheMergedMesh, PointOverLevels) { expect_same(ball_of(0.0), 3, 4); }
TEST(SceneIsTheMergedMesh, BallOverLevels) { expect_same(ball_of(0.8), 3, 5); }
TEST(SceneIsTheMergedMesh, BurrOverLevels) { expect_same(small_burr(), 3, 6); }

struct Changes {
    std::size_t ticks = 0, contacts = 0, changes = 0, let_go = 0, entered = 0, judged = 0, inside = 0, exchanged = 0;
    double deepest_mm = 0.0, longest_us = 0.0, longest_change_us = 0.0;
    int allocated = 0;
};

// Parts come and go and one is exchanged; every tick is within the force gate, allocates nothing, and leaves the tool
// outside of everything that is to be seen.
Changes change_at_random(const std::vector<BallData>& tool, bool blended, std::uint64_t seed, std::size_t ticks) {
    ConfigData config = heap_config(3, tool.size());
    if (!blended) config.blend_s = config.engage_s = 0.0;
    std::vector<SoakMesh> larger;
    for (const int n : {10, 6}) larger.push_back(moved(bumpy_body(n), 0.62, {0.5, 11.5, 0.0}));
    const ScenePart spare(std::move(larger), 0.9);
    const std::vector<const Part*> parts = pointers(heap());
    constexpr std::uint32_t kExchanged = 2;
    const ScenePart* in_its_place = &heap()[kExchanged];
    Renderer renderer;
    EXPECT_EQ(renderer.load_scene(config, parts, ~0ull, tool), "");
    EXPECT_EQ(renderer.refusal(kExchanged, *spare.part), "");
    HeapHand hand(seed);
    Changes out;
    TickRecord row{}, last{};
    std::uint64_t visible = renderer.visible();
    EXPECT_EQ(visible, 15u);
    std::size_t quiet = 1000;
    for (std::size_t t = 0; t < ticks; ++t) {
        bool changed = false;
        if (hand.dice().chance(0.015)) {
            const std::uint64_t next = hand.dice().below(16);
            out.let_go += (renderer.touched() & visible & ~next) != 0;
            changed = next != visible;
            renderer.show(visible = next);
        }
        if (hand.dice().chance(0.005)) {
            const ScenePart* next = in_its_place == &spare ? &heap()[kExchanged] : &spare;
            EXPECT_EQ(renderer.exchange(kExchanged, *next->part), in_its_place->part.get());
            in_its_place = next;
            changed = true;
            ++out.exchanged;
        }
        const Point hip = hand.next();
        const double start_us = thread_us();
#ifndef HAPTICLOD_SANITIZED
        watching = true;
        renderer.tick(pose_at(config, hip), 1e-3 * static_cast<double>(t), row);
        watching = false;
        out.allocated = allocations;
#else
        renderer.tick(pose_at(config, hip), 1e-3 * static_cast<double>(t), row);
#endif
        const double us = thread_us() - start_us;
        out.longest_us = std::max(out.longest_us, us);
        if (changed) out.longest_change_us = std::max(out.longest_change_us, us);
        ++out.ticks;
        out.contacts += row.contact;
        out.changes += changed;
        out.entered += (row.errors & kErrStartInside) != 0;
        const Point force{row.force_n[0], row.force_n[1], row.force_n[2]};
        const Point before{last.force_n[0], last.force_n[1], last.force_n[2]};
        EXPECT_LE(length(force), config.max_force_n * (1.0 + 1e-9));
        EXPECT_LE(length(force - before), config.max_slew_n_s * 1e-3 * (1.0 + 1e-6) + 1e-9);
        if ((row.errors & kErrStartInside) != 0 && blended && last.contact == 0) {
            EXPECT_LT(length(force), length(before) + 1e-9);  // what the gate lets fall
        }
        // While an offset decays, the rendered place is meant to be off the surface.
        quiet = changed || row.level != last.level ? 0 : quiet + 1;
        last = row;
        if (blended ? quiet < 60 || t % 16 != 0 : !changed && t % 16 != 0) continue;
        std::vector<const std::vector<Corners>*> seen;
        for (std::uint32_t i = 0; i < heap().size(); ++i)
            if (visible >> i & 1) seen.push_back(&(i == kExchanged ? *in_its_place : heap()[i]).at(row.level));
        const double clear = clearance(scp_of(row, config), tool, seen);
        out.deepest_mm = std::min(out.deepest_mm, clear);
        out.inside += clear < -1e-3;
        ++out.judged;
    }
    return out;
}

void expect_sound(const std::vector<BallData>& tool, bool blended, std::uint64_t seed) {
    const Changes c = change_at_random(tool, blended, seed, kChanging);
    std::printf(
        "[scene] %zu ticks, %zu in contact, %zu changes (%zu exchanges), %zu under contact, %zu entered, %zu "
        "judged, %zu inside, deepest %.3g mm, longest tick %.0f us, of a change %.0f us\n",
        c.ticks, c.contacts, c.changes, c.exchanged, c.let_go, c.entered, c.judged, c.inside, c.deepest_mm,
        c.longest_us, c.longest_change_us);
    EXPECT_EQ(c.allocated, 0);
    EXPECT_EQ(c.inside, 0u) << c.deepest_mm;
    EXPECT_GT(c.contacts, c.ticks / 5);
    EXPECT_GT(c.changes, c.ticks / 200);
    EXPECT_GT(c.judged, c.ticks / 100);
    EXPECT_GT(c.let_go, c.ticks / 2000);
    EXPECT_GT(c.entered, c.ticks / 2000);
}

TEST(SceneChanges, Point) { expect_sound(ball_of(0.0), false, 11); }
TEST(SceneChanges, Ball) { expect_sound(ball_of(0.8), false, 12); }
TEST(SceneChanges, Burr) { expect_sound(small_burr(), false, 13); }
TEST(SceneChanges, BallBlended) { expect_sound(ball_of(0.8), true, 14); }

// A ball pressed onto one body: hidden, the force decays and the ball goes to the hand; shown again, it comes back to
// where it was with a force that grows from nothing.
TEST(SceneChanges, HiddenUnderTheToolAndShownOverIt) {
    const std::vector<BallData> tool = ball_of(0.8);
    const ConfigData config = heap_config(3, 1);
    Renderer renderer;
    ASSERT_EQ(renderer.load_scene(config, pointers(heap()), ~0ull, tool), "");
    const Point outward = Point{-0.6, 0.0, 0.8}, middle = {-8.0, 0.0, 0.0};
    TickRecord row{};
    double time_s = 0.0;
    const auto tick = [&](double height_mm) {
        renderer.tick(pose_at(config, middle + outward * height_mm), time_s += 1e-3, row);
        return length({row.force_n[0], row.force_n[1], row.force_n[2]});
    };
    double pressed = 0.0;
    for (int t = 0; t < 400; ++t) pressed = tick(std::max(13.0 - 0.02 * t, 9.5));
    for (int t = 0; t < 200; ++t) pressed = tick(9.5);
    ASSERT_GT(pressed, 0.5);
    EXPECT_EQ(renderer.touched(), 1u);
    const Point resting = scp_of(row, config);
    renderer.show(0b1110);
    double last = pressed, force = pressed;
    for (int t = 0; t < 100; ++t, last = force) {
        force = tick(9.5);
        EXPECT_LE(force, last + 1e-12);
        EXPECT_GE(force, last - 1e-3 * config.max_slew_n_s - 1e-9);
    }
    EXPECT_EQ(force, 0.0);
    EXPECT_EQ(row.contact, 0);
    EXPECT_LT(length(scp_of(row, config) - (middle + outward * 9.5)), 1e-12);
    EXPECT_EQ(renderer.touched(), 0u);
    renderer.show(0b1111);
    last = 0.0;
    for (int t = 0; t < 100; ++t, last = force) {
        force = tick(9.5);
        EXPECT_EQ((row.errors & kErrStartInside) != 0, t == 0);
        EXPECT_LE(std::abs(force - last), 1.1e-3 * pressed / config.engage_s);
    }
    // The nearest place in front of the body is another than where the ball came from: they are a bump apart.
    EXPECT_NEAR(force, pressed, 0.05 * pressed);
    EXPECT_LT(length(scp_of(row, config) - resting), 2.0 * kBumpMm);
}

TEST(SceneChanges, MaterialsAreOfTheirPart) {
    std::vector<ScenePart> parts = heap_of_parts();
    ScenePart& soft = parts[0];
    std::vector<LevelView> views;
    for (LevelStorage& level : soft.levels) {
        ASSERT_EQ(level.set_materials(std::vector<Material>(level.view().vertex_count(), {0.25f, -1.0f, -1.0f})), "");
        views.push_back(level.view());
    }
    soft.part = std::make_unique<Part>(views);
    const ConfigData config = heap_config(3, 1);
    Renderer renderer;
    ASSERT_EQ(renderer.load_scene(config, pointers(parts), ~0ull, ball_of(0.8)), "");
    const auto stiffness_on = [&](const Point& middle, const Point& outward, double from_mm) {
        renderer.reset();
        TickRecord row{};
        for (int t = 0; t < 600; ++t) {
            const double height = std::max(from_mm - 0.01 * t, from_mm - 3.2);
            renderer.tick(pose_at(config, middle + outward * height), 1e-3 * t, row);
        }
        const double depth =
            length(Point{row.scp_mm[0] - row.hip_mm[0], row.scp_mm[1] - row.hip_mm[1], row.scp_mm[2] - row.hip_mm[2]});
        return length({row.force_n[0], row.force_n[1], row.force_n[2]}) / depth;
    };
    EXPECT_NEAR(stiffness_on({-8.0, 0.0, 0.0}, {-0.6, 0.0, 0.8}, 13.0), 0.25, 1e-3);
    EXPECT_NEAR(stiffness_on({7.0, 1.0, 2.0}, {0.6, 0.0, 0.8}, 11.0), 1.0, 1e-3);
}

TEST(SceneLoads, OrSaysWhyNot) {
    const std::vector<BallData> tool = ball_of(0.5);
    Renderer renderer;
    EXPECT_EQ(renderer.load_scene(heap_config(3, 1), {}, 1, tool), "a scene needs 1 to 64 parts");
    EXPECT_EQ(renderer.load_scene(heap_config(2, 1), pointers(heap()), 1, tool),
              "a part has more levels than level_count");
    const std::vector<const Part*> many(65, heap()[3].part.get());
    EXPECT_EQ(renderer.load_scene(heap_config(3, 1), many, 1, tool), "a scene needs 1 to 64 parts");
    const Part none({});
    EXPECT_EQ(none.fault(), "a part needs 1 to 8 levels");
    ASSERT_EQ(renderer.load_scene(heap_config(3, 1), pointers(heap()), 0b0101, tool), "");
    EXPECT_EQ(renderer.visible(), 0b0101u);
    EXPECT_EQ(renderer.refusal(4, *heap()[0].part), "there is no such part");
    const ScenePart far({moved(bumpy_body(4), 1.0, {500.0, 0.0, 0.0})}, 3.0);
    EXPECT_NE(renderer.refusal(1, *far.part), "");
    EXPECT_EQ(renderer.exchange(7, *heap()[0].part), nullptr);
}

}  // namespace
}  // namespace hapticlod::test
