#include "core/scene.hpp"

#include <algorithm>
#include <bit>

#include "core/material.hpp"

namespace hapticlod {
namespace {

// Which surfaces are shown, and what that makes of the level.
void show_only(SceneLevel& level, std::uint64_t parts) {
    level.visible_count = 0;
    level.closed = true;
    level.mean_edge_mm = level.cell_mm = 0.0;
    double triangles = 0.0;
    for (std::uint64_t bits = parts; bits != 0; bits &= bits - 1) {
        const auto i = static_cast<std::uint32_t>(std::countr_zero(bits));
        const ActiveLevel& surface = *level.surfaces[i];
        level.visible[level.visible_count++] = i;
        level.closed = level.closed && surface.closed;
        // As a running mean, which for one surface is exactly its own.
        const double more = surface.view.triangle_count();
        triangles += more;
        level.mean_edge_mm += (double{surface.view.hash->mean_edge_mm} - level.mean_edge_mm) * (more / triangles);
        level.cell_mm += (surface.view.hash->cell_mm - level.cell_mm) * (more / triangles);
    }
}

}  // namespace

Box Box::of(const HashHeader& h) {
    return {{h.bbox_min[0], h.bbox_min[1], h.bbox_min[2]}, {h.bbox_max[0], h.bbox_max[1], h.bbox_max[2]}};
}

void Box::add(const Box& o) {
    lo = {std::min(lo.x, o.lo.x), std::min(lo.y, o.lo.y), std::min(lo.z, o.lo.z)};
    hi = {std::max(hi.x, o.hi.x), std::max(hi.y, o.hi.y), std::max(hi.z, o.hi.z)};
}

double Box::distance2(const Vec3& p) const {
    return norm2(Vec3{std::max({lo.x - p.x, p.x - hi.x, 0.0}), std::max({lo.y - p.y, p.y - hi.y, 0.0}),
                      std::max({lo.z - p.z, p.z - hi.z, 0.0})});
}

Part::Part(std::span<const LevelView> levels) {
    if (levels.empty() || levels.size() > kMaxLevels) fault_ = "a part needs 1 to 8 levels";
    for (const LevelView& level : levels)
        if (level.hash == nullptr || level.triangle_count() == 0) fault_ = "a level is empty";
    for (const LevelView& level : levels)
        if (fault_.empty()) fault_ = check_materials(level.materials, level.vertex_count());
    if (!fault_.empty()) return;
    levels_.reserve(levels.size());
    for (const LevelView& level : levels) {
        const ActiveLevel& made = levels_.emplace_back(level);
        closed_ = closed_ && made.closed;
        has_materials_ = has_materials_ || !level.materials.empty();
    }
    box_ = Box::of(*levels[0].hash);
}

std::size_t Part::bytes() const {
    std::size_t size = sizeof(Part);
    for (const ActiveLevel& level : levels_) size += level.bytes();
    return size;
}

void Scene::load(std::span<const Part* const> parts, std::uint64_t visible, std::uint32_t level_count) {
    part_count_ = static_cast<std::uint32_t>(parts.size());
    parts_.fill(nullptr);
    std::copy(parts.begin(), parts.end(), parts_.begin());
    visible_ = visible;
    levels_.assign(level_count, {});
    for (std::uint32_t k = 0; k < level_count; ++k) fill(k);
}

void Scene::fill(std::uint32_t level) {
    SceneLevel& l = levels_[level];
    for (std::uint32_t i = 0; i < part_count_; ++i) {
        l.surfaces[i] = &parts_[i]->at(level);
        l.boxes[i] = Box::of(*l.surfaces[i]->view.hash);
    }
    // With nothing to be seen lengths still want a scale.
    if (visible_ == 0) show_only(l, all_parts(part_count_));
    const double edge = l.mean_edge_mm, cell = l.cell_mm;
    show_only(l, visible_);
    if (visible_ == 0) l.mean_edge_mm = edge, l.cell_mm = cell;
}

const SceneLevel& Scene::alone(std::uint32_t level, std::uint32_t part) {
    alone_.surfaces = levels_[level].surfaces;
    alone_.boxes[part] = levels_[level].boxes[part];
    show_only(alone_, 1ull << part);
    return alone_;
}

void Scene::show(std::uint64_t visible) {
    visible_ = visible;
    for (std::uint32_t k = 0; k < levels_.size(); ++k) fill(k);
}

const Part* Scene::exchange(std::uint32_t i, const Part* next) {
    const Part* before = parts_[i];
    parts_[i] = next;
    for (std::uint32_t k = 0; k < levels_.size(); ++k) fill(k);
    return before;
}

}  // namespace hapticlod
