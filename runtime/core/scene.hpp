// Parts of a scene: scans with poses and levels of their own, touched together by one loop. Levels are built where the
// part lies (relative to the scene's origin), so the solver knows no poses. At the scene's level k a part shows its
// level min(k, its count - 1). docs/scenes.md.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/occupancy.hpp"
#include "core/vec.hpp"

namespace hapticlod {

inline constexpr std::uint32_t kMaxParts = 64;  // one bit each
constexpr std::uint64_t all_parts(std::uint32_t count) { return count < 64 ? (std::uint64_t{1} << count) - 1 : ~0ull; }

struct Box {
    Vec3 lo{1e300, 1e300, 1e300}, hi{-1e300, -1e300, -1e300};

    static Box of(const HashHeader& h);
    void add(const Box& o);
    [[nodiscard]] double diagonal() const { return norm(hi - lo); }
    [[nodiscard]] double distance2(const Vec3& p) const;
};

// One part as the tick uses it. Making one allocates and takes long: do it on another thread, before it is exchanged.
class Part {
public:
    // Levels, finest first; their arrays must outlive this.
    explicit Part(std::span<const LevelView> levels);
    // Why it cannot be used; empty: it can.
    [[nodiscard]] const std::string& fault() const { return fault_; }

    [[nodiscard]] std::uint32_t level_count() const { return static_cast<std::uint32_t>(levels_.size()); }
    [[nodiscard]] const ActiveLevel& at(std::uint32_t level) const {
        return levels_[std::min<std::size_t>(level, levels_.size() - 1)];
    }
    [[nodiscard]] const Box& box() const { return box_; }  // of the finest level
    [[nodiscard]] bool closed() const { return closed_; }  // every level is
    [[nodiscard]] bool has_materials() const { return has_materials_; }
    [[nodiscard]] std::size_t bytes() const;

private:
    std::vector<ActiveLevel> levels_;
    Box box_;
    bool closed_ = true, has_materials_ = false;
    std::string fault_;
};

// What the solver is bound to: the surfaces that one level of the scene shows.
struct SceneLevel {
    std::array<const ActiveLevel*, kMaxParts> surfaces{};  // by part, hidden ones too
    std::array<Box, kMaxParts> boxes;                      // of those surfaces
    std::array<std::uint32_t, kMaxParts> visible{};
    std::uint32_t visible_count = 0;
    bool closed = false;                       // every surface it shows: what is behind one is inside
    double mean_edge_mm = 0.0, cell_mm = 0.0;  // means over the triangles it shows
};

class Scene {
public:
    // Parts must outlive the scene, or their exchange.
    void load(std::span<const Part* const> parts, std::uint64_t visible, std::uint32_t level_count);

    [[nodiscard]] const SceneLevel& at(std::uint32_t level) const { return levels_[level]; }
    // The same with this part alone to be seen, whether visible or not. Valid until it is asked for again.
    [[nodiscard]] const SceneLevel& alone(std::uint32_t level, std::uint32_t part);
    [[nodiscard]] const Part& part(std::uint32_t i) const { return *parts_[i]; }
    [[nodiscard]] std::uint32_t part_count() const { return part_count_; }
    [[nodiscard]] std::uint64_t visible() const { return visible_; }
    [[nodiscard]] std::size_t bytes() const { return levels_.size() * sizeof(SceneLevel) + sizeof(alone_); }

    void show(std::uint64_t visible);
    const Part* exchange(std::uint32_t i, const Part* next);

private:
    void fill(std::uint32_t level);

    std::array<const Part*, kMaxParts> parts_{};
    std::uint32_t part_count_ = 0;
    std::uint64_t visible_ = 0;
    std::vector<SceneLevel> levels_;
    SceneLevel alone_;
};

}  // namespace hapticlod
