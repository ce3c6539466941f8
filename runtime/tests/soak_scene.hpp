// What the soak test moves on: three levels of a closed bumpy body or of a 0.3 mm plate, a tool, and a configuration,
// all drawn from one seed.
#pragma once
#include <cmath>
#include <map>
#include <numbers>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "core/renderer.hpp"
#include "tests/brute_force.hpp"

namespace hapticlod::test {

// Uniform in [lo, hi), the same numbers with every standard library.
class Dice {
public:
    explicit Dice(std::uint64_t seed) : bits_(seed) {}
    double between(double lo, double hi) { return lo + (hi - lo) * static_cast<double>(bits_() >> 11) * 0x1p-53; }
    bool chance(double p) { return between(0.0, 1.0) < p; }
    std::size_t below(std::size_t n) { return static_cast<std::size_t>(bits_() % n); }
    Point direction() {
        const double z = between(-1.0, 1.0), a = between(0.0, 2.0 * std::numbers::pi), s = std::sqrt(1.0 - z * z);
        return {s * std::cos(a), s * std::sin(a), z};
    }

    // In any direction, of a length between the two. One draw after the other: operands have no order of their own.
    Point vector(double lo, double hi) {
        const Point way = direction();
        return way * between(lo, hi);
    }

private:
    std::mt19937_64 bits_;
};

struct SoakMesh {
    std::vector<float> vertices;
    std::vector<std::uint32_t> faces;

    std::uint32_t add(const Point& p) {
        for (const double v : p) vertices.push_back(static_cast<float>(v));
        return static_cast<std::uint32_t>(vertices.size() / 3 - 1);
    }
};

inline constexpr double kBodyRadiusMm = 10.0, kBumpMm = 0.25;
inline constexpr double kPlateHalfMm = 10.0, kPlateThicknessMm = 0.3;

// A sphere with bumps of kBumpMm: a cube's faces in n x n squares, blown up.
inline SoakMesh bumpy_body(int n) {
    SoakMesh mesh;
    std::map<std::array<int, 3>, std::uint32_t> known;
    const auto vertex = [&](const std::array<int, 3>& at) {
        const auto [slot, fresh] = known.try_emplace(at, 0);
        if (fresh) {
            Point u;
            for (std::size_t k = 0; k < 3; ++k) u[k] = std::tan(std::numbers::pi / 4.0 * (2.0 * at[k] / n - 1.0));
            u = u * (1.0 / length(u));
            const double bump = std::sin(7.0 * u[0] + 1.0) * std::sin(8.0 * u[1] + 2.0) * std::sin(6.0 * u[2] + 0.5);
            slot->second = mesh.add(u * (kBodyRadiusMm + kBumpMm * bump));
        }
        return slot->second;
    };
    for (std::size_t axis = 0; axis < 3; ++axis)
        for (const int end : {0, n})
            for (int i = 0; i < n; ++i)
                for (int j = 0; j < n; ++j) {
                    std::uint32_t c[4];
                    for (int k = 0; k < 4; ++k) {
                        std::array<int, 3> at{};
                        at[axis] = end;
                        at[(axis + 1) % 3] = i + (k == 1 || k == 2);
                        at[(axis + 2) % 3] = j + (k >= 2);
                        c[k] = vertex(at);
                    }
                    if (end == 0) std::swap(c[1], c[3]);
                    mesh.faces.insert(mesh.faces.end(), {c[0], c[1], c[2], c[0], c[2], c[3]});
                }
    return mesh;
}

// A closed box of n x n squares on both sides, its upper side at z = kPlateThicknessMm / 2.
inline SoakMesh thin_plate(int n) {
    SoakMesh mesh;
    for (const double z : {0.5 * kPlateThicknessMm, -0.5 * kPlateThicknessMm})
        for (int i = 0; i <= n; ++i)
            for (int j = 0; j <= n; ++j)
                mesh.add({kPlateHalfMm * (2.0 * i / n - 1.0), kPlateHalfMm * (2.0 * j / n - 1.0), z});
    const auto at = [n](int side, int i, int j) {
        return static_cast<std::uint32_t>(side * (n + 1) * (n + 1) + i * (n + 1) + j);
    };
    const auto square = [&mesh](std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
        mesh.faces.insert(mesh.faces.end(), {a, b, c, a, c, d});
    };
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            square(at(0, i, j), at(0, i + 1, j), at(0, i + 1, j + 1), at(0, i, j + 1));
            square(at(1, i, j), at(1, i, j + 1), at(1, i + 1, j + 1), at(1, i + 1, j));
        }
        square(at(0, i, 0), at(1, i, 0), at(1, i + 1, 0), at(0, i + 1, 0));
        square(at(0, i + 1, n), at(1, i + 1, n), at(1, i, n), at(0, i, n));
        square(at(0, 0, i + 1), at(1, 0, i + 1), at(1, 0, i), at(0, 0, i));
        square(at(0, n, i), at(1, n, i), at(1, n, i + 1), at(0, n, i + 1));
    }
    return mesh;
}

struct SoakBody {
    const char* name;
    bool plate;
    LevelStorage levels[3];
    std::vector<Corners> corners[3];
    double innermost_mm[3];  // of the bumpy body: no point of the surface is nearer to its middle
    std::string fault;

    SoakBody(bool is_plate, double cell_mm) : name(is_plate ? "plate" : "bumpy body"), plate(is_plate) {
        const int cells[3] = {is_plate ? 16 : 14, is_plate ? 9 : 9, is_plate ? 4 : 6};
        for (int k = 0; k < 3; ++k) {
            const SoakMesh mesh = is_plate ? thin_plate(cells[k]) : bumpy_body(cells[k]);
            if (fault.empty()) fault = levels[k].build(mesh.vertices, mesh.faces, cell_mm);
            corners[k] = corners_of(mesh.vertices, mesh.faces);
            innermost_mm[k] = distance_to({0.0, 0.0, 0.0}, corners[k]);
        }
    }
};

// Meshes are shared by all runs; building them is not what is tested.
struct SoakBodies {
    SoakBody body{false, 1.2}, plate{true, 1.0};
};

// What a run is about. Apart, so that a fault in one leaves the others watched.
enum class SoakKind { ball, rubbing_ball, burr, rubbing_burr, nested_burr };
inline constexpr SoakKind kSoakKinds[] = {SoakKind::ball, SoakKind::rubbing_ball, SoakKind::burr,
                                          SoakKind::rubbing_burr, SoakKind::nested_burr};
inline const char* name_of(SoakKind kind) {
    constexpr const char* names[] = {"ball", "rubbing_ball", "burr", "rubbing_burr", "nested_burr"};
    return names[static_cast<int>(kind)];
}

struct SoakCase {
    const SoakBody* body;
    ConfigData config{};
    std::vector<BallData> tool;
    std::string name;
};

inline SoakCase soak_case(const SoakBodies& bodies, SoakKind kind, std::uint64_t seed) {
    Dice dice(seed * 0x9e3779b97f4a7c15ull + 1);
    SoakCase c;
    c.body = seed % 2 == 0 ? &bodies.body : &bodies.plate;
    if (kind == SoakKind::ball || kind == SoakKind::rubbing_ball) {
        constexpr double radii_mm[] = {0.0, 0.4, 1.5};
        c.tool = {BallData{{0.0, 0.0, 0.0}, radii_mm[seed / 2 % 3]}};
    } else {
        const bool jack = seed / 2 % 2 == 0;  // four balls apart, or nine in a heap
        for (int i = 0; i < (jack ? 4 : 9); ++i) {
            const Point at = dice.vector(0.2, jack ? 1.0 : 0.7);
            c.tool.push_back({{at[0], at[1], at[2]}, i % 3 == 2 ? 0.0 : dice.between(0.05, 0.6)});
        }
    }
    ConfigData& g = c.config;
    g.version = kConfigVersion;
    g.level_count = 3;
    g.mapping = static_cast<std::uint32_t>(Mapping::two_sided);
    g.shading = dice.chance(0.5);
    const Point origin = dice.direction() * 30.0;
    for (int k = 0; k < 3; ++k) g.origin_mm[k] = origin[k];
    g.loop_hz = 1000.0;
    g.stiffness_n_mm = dice.between(0.2, 3.0);
    g.damping_n_s_mm = dice.chance(0.5) ? 0.0 : dice.between(0.0, 2e-3);
    const bool rubs = kind == SoakKind::rubbing_ball || kind == SoakKind::rubbing_burr;
    g.friction_static = rubs ? dice.between(0.1, 0.8) : 0.0;
    g.friction_dynamic = g.friction_static * dice.between(0.3, 1.0);
    g.filter_hz = dice.between(20.0, 200.0);
    g.hysteresis = dice.between(0.0, 0.2);
    g.dwell_s = dice.chance(0.5) ? 0.0 : dice.between(0.0, 0.02);
    g.l_in_mm = g.l_out_mm = g.closest_bound_mm = c.body->plate ? 0.2 : 1.0;
    g.blend_s = dice.chance(0.5) ? 0.0 : dice.between(0.005, 0.05);
    g.max_force_n = dice.between(2.0, 8.0);
    g.max_slew_n_s = dice.between(500.0, 4000.0);
    g.engage_s = 0.05;
    g.speeds_mm_s[0] = dice.between(40.0, 150.0);
    g.speeds_mm_s[1] = dice.between(200.0, 400.0);
    for (std::size_t k = 0; k < 3; ++k) {
        g.cell_mm[k] = c.body->levels[k].view().hash->cell_mm;
        const std::size_t fewer = kind == SoakKind::nested_burr ? k : 0;
        g.balls[k] = static_cast<std::uint32_t>(std::max<std::size_t>(c.tool.size() * (3 - fewer) / 3, 1));
    }
    c.name = std::string(c.body->name) + ", " + std::to_string(c.tool.size()) + " ball" +
             (c.tool.size() > 1 ? "s" : " of " + std::to_string(c.tool[0].radius_mm) + " mm") +
             (g.friction_static > 0.0 ? ", friction" : "") + (g.blend_s > 0.0 ? ", blend" : "") +
             (g.shading != 0 ? ", shading" : "");
    return c;
}

}  // namespace hapticlod::test
