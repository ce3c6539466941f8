// The runtime's contacts against Embree's rays and closest points, on a generated body and on a real scan.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <memory>

#include "bench/stl_mesh.hpp"
#include "tests/embree_oracle.hpp"
#include "tests/soak_scene.hpp"

namespace hapticlod::test {
namespace {

constexpr double kMicron = 1e-3;

// The 8000-triangle crop of a scanned jaw among the project's data, or "".
std::string crop_file() {
    const char* folder = std::getenv("HAPTICLOD_DATA");
    const std::filesystem::path data = folder != nullptr && *folder != 0
                                           ? std::filesystem::path(folder)
                                           : std::filesystem::path(HAPTICLOD_REPOSITORY).parent_path() / "shared/data";
    const std::filesystem::path file = data / "dirty/14_binary_solid_header.stl";
    return std::filesystem::exists(file) ? file.string() : "";
}

struct Surface {
    std::vector<float> vertices;
    std::vector<std::uint32_t> faces;
    double diagonal_mm = 0.0;

    Surface(std::vector<float> v, std::vector<std::uint32_t> f) : vertices(std::move(v)), faces(std::move(f)) {
        Point lo = {1e300, 1e300, 1e300}, hi = {-1e300, -1e300, -1e300};
        for (std::size_t i = 0; i < vertices.size(); ++i) {
            lo[i % 3] = std::min(lo[i % 3], double{vertices[i]});
            hi[i % 3] = std::max(hi[i % 3], double{vertices[i]});
        }
        // About its middle, as in a bundle.
        for (std::size_t i = 0; i < vertices.size(); ++i)
            vertices[i] = static_cast<float>(double{vertices[i]} - 0.5 * (lo[i % 3] + hi[i % 3]));
        diagonal_mm = length(hi - lo);
    }
    [[nodiscard]] Corners face(std::size_t i) const {
        return corners_of(vertices, std::span(faces).subspan(3 * i, 3)).front();
    }
    [[nodiscard]] Point middle(std::size_t i) const { return (face(i).a + face(i).b + face(i).c) * (1.0 / 3.0); }
    [[nodiscard]] Point normal(std::size_t i) const {
        const Corners t = face(i);
        const Point n = outer(t.b - t.a, t.c - t.a);
        return n * (1.0 / length(n));
    }
};

class EmbreeContact : public testing::TestWithParam<const char*> {
protected:
    void SetUp() override {
        if (std::string(GetParam()) == "crop") {
            const std::string file = crop_file();
            if (file.empty())
                GTEST_SKIP() << "real scans not found: set HAPTICLOD_DATA to the folder that holds dirty/";
            bench::Mesh mesh = bench::read_stl(file);
            surface_ = std::make_unique<Surface>(std::move(mesh.vertices), std::move(mesh.faces));
        } else {
            SoakMesh mesh = bumpy_body(40);
            surface_ = std::make_unique<Surface>(std::move(mesh.vertices), std::move(mesh.faces));
        }
        ASSERT_EQ(level_.build(surface_->vertices, surface_->faces, 0.8), "");
        embree_ = std::make_unique<EmbreeOracle>(surface_->vertices, surface_->faces);
        skin_mm_ = 4e-6 * surface_->diagonal_mm;
    }

    Renderer renderer(double radius_mm) {
        ConfigData c{};
        c.version = kConfigVersion;
        c.level_count = 1;
        c.mapping = static_cast<std::uint32_t>(Mapping::two_sided);
        c.loop_hz = 1000.0;
        c.stiffness_n_mm = 1.0;
        c.cell_mm[0] = 0.8;
        c.balls[0] = 1;
        Renderer made;
        const LevelView view = level_.view();
        const BallData ball{{0.0, 0.0, 0.0}, radius_mm};
        EXPECT_EQ(made.load(c, {&view, 1}, {&ball, 1}), "");
        return made;
    }

    std::unique_ptr<Surface> surface_;
    std::unique_ptr<EmbreeOracle> embree_;
    LevelStorage level_;
    double skin_mm_ = 0.0;
};

TickRecord tick(Renderer& renderer, const Point& hip, double time_s) {
    TickRecord row;
    renderer.tick({{hip[0], hip[1], hip[2]}}, time_s, row);
    return row;
}

Point scp_of(const TickRecord& row) { return {row.scp_mm[0], row.scp_mm[1], row.scp_mm[2]}; }

// The tests' own brute force first: Embree's closest points are an oracle for it too.
TEST_P(EmbreeContact, ClosestPointsAgreeWithBruteForce) {
    Dice dice(1);
    const std::vector<Corners> all = corners_of(surface_->vertices, surface_->faces);
    for (int i = 0; i < 300; ++i) {
        const Point middle = surface_->middle(dice.below(all.size()));
        const Point at = middle + dice.vector(0.0, 3.0);
        EXPECT_NEAR(embree_->closest(at), distance_to(at, all), 1e-6);
    }
}

// In contact a ball's centre is a radius away from the surface, free it is no nearer.
TEST_P(EmbreeContact, ABallRestsARadiusAway) {
    for (const double radius_mm : {0.0, 0.1, 0.5, 1.0, 3.0}) {
        Dice dice(2);
        Renderer one = renderer(radius_mm);
        int ticks = 0, contacts = 0, unsettled = 0;
        double nearest = 1e300, farthest = 0.0;
        for (int stroke = 0; stroke < 60; ++stroke) {
            const std::size_t f = dice.below(surface_->faces.size() / 3), g = dice.below(surface_->faces.size() / 3);
            const Point above = surface_->middle(f) + surface_->normal(f) * (radius_mm + 1.5);
            if (embree_->closest(above) < radius_mm + 0.1) continue;  // a start in overlap is another test's
            const Point in = surface_->middle(f) - surface_->normal(f) * (0.5 - radius_mm);
            const Point to = in + (surface_->middle(g) - in) * std::min(1.0, 3.0 / length(surface_->middle(g) - in));
            one.reset();
            const int steps = 20 + static_cast<int>(dice.below(60));
            for (int t = 0; t <= 2 * steps; ++t, ++ticks) {
                const double s = static_cast<double>(t % (steps + 1)) / steps;
                const Point hip = t <= steps ? above + (in - above) * s : in + (to - in) * s;
                const TickRecord row = tick(one, hip, 1e-3 * ticks);
                unsettled += (row.errors & kErrNotConverged) != 0;
                const double clearance = embree_->closest(scp_of(row)) - radius_mm;
                nearest = std::min(nearest, clearance);
                if (row.contact != 0 && (row.errors & kErrNotConverged) == 0)
                    farthest = std::max(farthest, clearance), ++contacts;
            }
        }
        EXPECT_GT(contacts, 500) << "r = " << radius_mm;
        EXPECT_LT(unsettled, ticks / 100) << "r = " << radius_mm;
        EXPECT_GT(nearest, -kMicron) << "r = " << radius_mm;
        EXPECT_LT(farthest, kMicron) << "r = " << radius_mm;
    }
}

// A point that flies far in one tick is stopped where Embree's ray meets the surface, and not a micron before.
TEST_P(EmbreeContact, AFastPointStopsWhereTheRayHits) {
    Dice dice(3);
    Renderer point = renderer(0.0);
    const double little = 20.0 * skin_mm_;
    int hits = 0, near_misses = 0;
    for (int i = 0; i < 6000; ++i) {
        const std::size_t f = dice.below(surface_->faces.size() / 3), g = dice.below(surface_->faces.size() / 3);
        const Point from = surface_->middle(f) + surface_->normal(f) * dice.between(0.5, 4.0);
        const Point aim = surface_->middle(g) + dice.direction() * 0.05;
        const Point way = (aim - from) * (1.0 / length(aim - from));
        const double far = embree_->first_hit(from, way);
        if (!std::isfinite(far) || far < 0.05 || embree_->closest(from) < 0.1) continue;
        const Point hit = from + way * far;
        point.reset();
        // Open sheets may be started behind; a closed body not, and `from` may lie in one where it is thin.
        if ((tick(point, from, 0.0).errors & kErrStartInside) != 0) continue;
        const TickRecord row = tick(point, from + way * (far + little), 1e-3);
        // Float rays are good to about 1e-6 of the coordinates.
        ASSERT_EQ(row.contact, 1) << "ray " << i << ": fell through, " << far << " mm away";
        ASSERT_LT(length(scp_of(row) - hit), 2.0 * little + 1e-5 * surface_->diagonal_mm) << "ray " << i;
        ++hits;
        const Point before = from + way * (far - 0.02);
        if (embree_->closest(before) < 4.0 * skin_mm_) continue;  // grazing
        point.reset();
        (void)tick(point, from, 0.0);
        const TickRecord free = tick(point, before, 1e-3);
        ASSERT_EQ(free.contact, 0) << "ray " << i << ": stopped in the air";
        ASSERT_LT(length(scp_of(free) - before), 1e-9);
        ++near_misses;
    }
    EXPECT_GT(hits, 3000);
    EXPECT_GT(near_misses, 2000);
}

INSTANTIATE_TEST_SUITE_P(Surfaces, EmbreeContact, testing::Values("body", "crop"),
                         [](const auto& name) { return std::string(name.param); });

}  // namespace
}  // namespace hapticlod::test
