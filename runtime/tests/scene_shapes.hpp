// Small scenes for the tests: bodies that overlap, with levels, cells and level counts of their own, and the same as
// one merged mesh.
#pragma once
#include <memory>
#include <vector>

#include "core/renderer.hpp"
#include "tests/soak_scene.hpp"

namespace hapticlod::test {

inline SoakMesh moved(SoakMesh mesh, double scale, const Point& to) {
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i)
        mesh.vertices[i] = static_cast<float>(double{mesh.vertices[i]} * scale + to[i % 3]);
    return mesh;
}

struct ScenePart {
    std::vector<SoakMesh> meshes;  // finest first
    std::vector<LevelStorage> levels;
    std::vector<std::vector<Corners>> corners;
    std::unique_ptr<Part> part;
    std::string fault;

    ScenePart(std::vector<SoakMesh> given, double cell_mm) : meshes(std::move(given)), levels(meshes.size()) {
        std::vector<LevelView> views;
        for (std::size_t k = 0; k < meshes.size(); ++k) {
            if (fault.empty()) fault = levels[k].build(meshes[k].vertices, meshes[k].faces, cell_mm);
            corners.push_back(corners_of(meshes[k].vertices, meshes[k].faces));
            views.push_back(levels[k].view());
        }
        part = std::make_unique<Part>(views);
    }
    [[nodiscard]] const std::vector<Corners>& at(std::size_t level) const {
        return corners[std::min(level, corners.size() - 1)];
    }
};

// Bodies of 10, 8 and 5 mm in a heap, and a plate that cuts through two of them; 3, 2, 1 and 2 levels.
inline std::vector<ScenePart> heap_of_parts() {
    std::vector<ScenePart> parts;
    const auto bodies = [](std::initializer_list<int> sizes, double scale, const Point& to) {
        std::vector<SoakMesh> meshes;
        for (const int n : sizes) meshes.push_back(moved(bumpy_body(n), scale, to));
        return meshes;
    };
    parts.emplace_back(bodies({14, 9, 6}, 1.0, {-8.0, 0.0, 0.0}), 1.2);
    parts.emplace_back(bodies({12, 8}, 0.8, {7.0, 1.0, 2.0}), 0.7);
    parts.emplace_back(bodies({8}, 0.5, {0.0, 11.0, 1.0}), 2.0);
    std::vector<SoakMesh> plates;
    for (const int n : {12, 5}) plates.push_back(moved(thin_plate(n), 0.9, {1.0, -6.0, 3.0}));
    parts.emplace_back(std::move(plates), 1.5);
    return parts;
}

inline std::vector<const Part*> pointers(const std::vector<ScenePart>& parts) {
    std::vector<const Part*> out;
    for (const ScenePart& p : parts) out.push_back(p.part.get());
    return out;
}

// What the scene shows at each of its levels, as one mesh.
inline std::vector<SoakMesh> merged(const std::vector<ScenePart>& parts, std::size_t levels) {
    std::vector<SoakMesh> out(levels);
    for (std::size_t k = 0; k < levels; ++k)
        for (const ScenePart& p : parts) {
            const SoakMesh& mesh = p.meshes[std::min(k, p.meshes.size() - 1)];
            const auto first = static_cast<std::uint32_t>(out[k].vertices.size() / 3);
            out[k].vertices.insert(out[k].vertices.end(), mesh.vertices.begin(), mesh.vertices.end());
            for (const std::uint32_t i : mesh.faces) out[k].faces.push_back(first + i);
        }
    return out;
}

inline ConfigData heap_config(std::uint32_t levels, std::size_t balls) {
    ConfigData g{};
    g.version = kConfigVersion;
    g.level_count = levels;
    g.mapping = static_cast<std::uint32_t>(Mapping::two_sided);
    g.origin_mm[0] = 20.0, g.origin_mm[1] = -30.0, g.origin_mm[2] = 5.0;
    g.loop_hz = 1000.0;
    g.stiffness_n_mm = 1.0;
    g.filter_hz = 80.0;
    g.hysteresis = 0.1;
    g.l_in_mm = g.l_out_mm = g.closest_bound_mm = 0.6;
    g.blend_s = 0.02;
    g.max_force_n = 6.0;
    g.max_slew_n_s = 2000.0;
    g.engage_s = 0.05;
    for (std::uint32_t k = 0; k < levels; ++k) {
        g.cell_mm[k] = 1.0;
        g.balls[k] = static_cast<std::uint32_t>(balls);
        g.speeds_mm_s[k] = k == 0 ? 80.0 : 250.0;
    }
    return g;
}

inline std::vector<BallData> ball_of(double radius_mm) { return {{{0.0, 0.0, 0.0}, radius_mm}}; }
inline std::vector<BallData> small_burr() {
    return {{{0.0, 0.0, 0.0}, 0.5}, {{0.6, 0.0, 0.2}, 0.4}, {{-0.5, 0.3, 0.0}, 0.0}, {{0.1, -0.5, 0.6}, 0.3}};
}

// Strokes from outside the heap to somewhere on or in it, along it and out again.
class HeapHand {
public:
    explicit HeapHand(std::uint64_t seed) : dice_(seed) { at_ = to_ = outside(); }

    Point next() {
        if (left_ == 0) begin();
        --left_;
        const double s = 1.0 - static_cast<double>(left_) / static_cast<double>(ticks_);
        at_ = from_ + (to_ - from_) * (s * s * s * (10.0 + s * (6.0 * s - 15.0)));
        return at_;
    }
    Dice& dice() { return dice_; }

private:
    Point outside() { return dice_.vector(24.0, 26.0); }
    Point near_surface() {
        const Point middles[] = {{-8.0, 0.0, 0.0}, {7.0, 1.0, 2.0}, {0.0, 11.0, 1.0}, {1.0, -6.0, 3.0}};
        const double radii[] = {10.0, 8.0, 5.0, 4.0};
        const std::size_t i = dice_.below(4);
        return middles[i] + dice_.vector(0.85, 1.02) * radii[i];
    }
    void begin() {
        from_ = at_;
        const std::size_t way = stroke_++ % 5;
        to_ = way == 4 ? outside() : near_surface();
        const double speed_mm_s = std::exp(dice_.between(std::log(15.0), std::log(300.0)));
        ticks_ = left_ = std::max<std::size_t>(1, static_cast<std::size_t>(length(to_ - from_) / speed_mm_s * 1e3));
    }

    Dice dice_;
    Point at_{}, from_{}, to_{};
    std::size_t ticks_ = 1, left_ = 0, stroke_ = 0;
};

}  // namespace hapticlod::test
