// One level: a mesh and its voxel hash. LevelView points at arrays that live elsewhere (a mapped bundle or a
// LevelStorage); it owns nothing, so a bundle is used in place.
// The paper's LODNode (Zhou et al. 2009, section 2.1) carries the same six things: mesh, mesh-voxel relation,
// vertex normals, face normals (computed from the mesh), vertex adjacency (faces around), face adjacency.
#pragma once
#include <bit>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/layout.hpp"
#include "core/morton.hpp"

namespace hapticlod {

inline constexpr std::size_t kMostElements = 0x3fffffffu;  // faces or vertices of a level

struct LevelView {
    std::span<const float> vertices;           // 3 per vertex, mm relative to ConfigData::origin_mm
    std::span<const std::uint32_t> faces;      // 3 per triangle
    std::span<const std::uint32_t> adjacency;  // 3 per triangle: neighbour across edge (k, k+1), or kNoNeighbour
    std::span<const float> normals;            // 3 per vertex, unit (0 where undefined)
    const HashHeader* hash = nullptr;
    std::span<const std::uint32_t> table;
    std::span<const Brick> bricks;
    std::span<const std::uint32_t> cells;  // cell_count + 1
    std::span<const TriBlock> blocks;
    std::span<const BlockBound> bounds;   // one per block, or none: then whoever uses the level computes them
    std::span<const Material> materials;  // one per vertex, or none: then everything is the station's

    [[nodiscard]] std::uint32_t triangle_count() const { return static_cast<std::uint32_t>(faces.size() / 3); }
    [[nodiscard]] std::uint32_t vertex_count() const { return static_cast<std::uint32_t>(vertices.size() / 3); }
    [[nodiscard]] std::size_t bytes() const {
        return vertices.size_bytes() + faces.size_bytes() + adjacency.size_bytes() + normals.size_bytes() +
               sizeof(HashHeader) + table.size_bytes() + bricks.size_bytes() + cells.size_bytes() +
               blocks.size_bytes() + materials.size_bytes();
    }
};

// The brick at these brick coordinates, or nullptr. Linear probing in the level's table.
inline const Brick* find_brick(const LevelView& level, std::int32_t x, std::int32_t y, std::int32_t z) {
    const std::uint32_t mask = level.hash->table_size - 1;
    for (std::uint32_t slot = brick_hash(x, y, z) & mask;; slot = (slot + 1) & mask) {
        const std::uint32_t entry = level.table[slot];
        if (entry == 0) return nullptr;
        const Brick& brick = level.bricks[entry - 1];
        if (brick.x == x && brick.y == y && brick.z == z) return &brick;
    }
}

// Where the cell of this bit is in LevelView::cells: the brick's cells follow each other in the order of their bits.
inline std::uint32_t cell_of(const Brick& brick, int bit) {
    const std::uint64_t below = brick.mask & ((std::uint64_t{1} << bit) - 1);
    return brick.first_cell + static_cast<std::uint32_t>(std::popcount(below));
}

// Owns a level built from a mesh. Building allocates; nothing after it does.
class LevelStorage {
public:
    // Builds hash, adjacency and normals. Faces keep their order; indices must be in range and vertices finite:
    // otherwise returns the reason (empty string: success).
    [[nodiscard]] std::string build(std::span<const float> vertices, std::span<const std::uint32_t> faces,
                                    double cell_mm);
    // One per vertex of the mesh that was built, or none. Returns the reason where they cannot be (empty: success).
    [[nodiscard]] std::string set_materials(std::span<const Material> materials);
    [[nodiscard]] LevelView view() const;

private:
    std::vector<float> vertices_, normals_;
    std::vector<std::uint32_t> faces_, adjacency_, table_, cells_;
    std::vector<Brick> bricks_;
    std::vector<TriBlock> blocks_;
    std::vector<Material> materials_;
    HashHeader header_{};
};

// Finite, and within 10^9 mm.
[[nodiscard]] std::string check_vertices(std::span<const float> vertices);

// Checks of a view whose arrays come from a file; empty string: usable. All of them passed, the tick may trust every
// index. The first takes no time: sizes agree with each other and with the hash's header, which is valid. The others
// read every element, each of its own arrays, and hold for any content: they may run at once in several threads, once
// the first has passed.
[[nodiscard]] std::string check_level_sizes(const LevelView& view);
[[nodiscard]] std::string check_level_mesh(const LevelView& view);  // vertices and normals, indices of both
[[nodiscard]] std::string check_level_hash(const LevelView& view);  // bricks, cells, table
// Blocks [first, last): the triangles they name, with the mesh's corners.
[[nodiscard]] std::string check_level_blocks(const LevelView& view, std::size_t first, std::size_t last);
// Whether each of these blocks, which hold what they should, lies within its stored bound.
[[nodiscard]] std::string check_bounds(std::span<const TriBlock> blocks, std::span<const BlockBound> bounds);

}  // namespace hapticlod
