// Content checks of a level that comes from a file: after them, the tick may trust every index.
#include <algorithm>
#include <bit>
#include <cmath>

#include "core/level.hpp"
#include "core/morton.hpp"

namespace hapticlod {
namespace {

// Whether every element is right. In pieces without an exit, which a compiler makes vectors of: these arrays are
// hundreds of megabytes.
template <class T, class Right>
bool all_right(std::span<const T> values, Right&& right) {
    constexpr std::size_t kPiece = 4096;
    while (!values.empty()) {
        const auto piece = values.first(std::min(kPiece, values.size()));
        std::uint32_t wrong = 0;
        for (const T value : piece) wrong |= right(value) ? 0u : 1u;
        if (wrong != 0) return false;
        values = values.subspan(piece.size());
    }
    return true;
}

}  // namespace

std::string check_level_sizes(const LevelView& view) {
    if (view.hash == nullptr) return "the hash header is missing";
    const HashHeader& h = *view.hash;
    const std::size_t nv = view.vertices.size() / 3, nf = view.faces.size() / 3;
    if (nv == 0 || view.vertices.size() % 3 != 0) return "the vertex array is empty or not in threes";
    if (nf == 0 || view.faces.size() % 3 != 0) return "the face array is empty or not in threes";
    if (nv > kMostElements || nf > kMostElements) return "the mesh has more than 2^30 faces or vertices";
    if (view.adjacency.size() != view.faces.size()) return "adjacency and faces differ in size";
    if (view.normals.size() != view.vertices.size()) return "normals and vertices differ in size";
    if (!(h.cell_mm > 0.0) || !std::isfinite(h.cell_mm)) return "cell_mm is not positive and finite";
    if (h.table_size == 0 || !std::has_single_bit(h.table_size) || view.table.size() != h.table_size)
        return "the hash table's size is not the stated power of two";
    if (view.bricks.size() != h.brick_count || h.brick_count == 0) return "the brick count is wrong";
    if (h.table_size <= h.brick_count) return "the hash table has no free slot";
    if (view.cells.size() != std::size_t{h.cell_count} + 1) return "the cell count is wrong";
    if (view.blocks.size() != h.block_count || h.block_count == 0) return "the block count is wrong";
    for (int k = 0; k < 3; ++k) {
        if (!std::isfinite(h.bbox_min[k]) || !std::isfinite(h.bbox_max[k]) || h.bbox_min[k] > h.bbox_max[k])
            return "the bounding box is not valid";
        if (h.brick_min[k] > h.brick_max[k] || h.brick_min[k] < -(1 << 20) || h.brick_max[k] >= (1 << 20))
            return "the brick bounds are not valid";
    }
    if (!(h.mean_edge_mm >= 0.0f) || !std::isfinite(h.mean_edge_mm) || !std::isfinite(h.max_edge_mm) ||
        !(h.max_edge_mm >= 0.0f))
        return "an edge length is not valid";
    if (!(h.loose_mm >= 0.0f && double{h.loose_mm} <= h.cell_mm)) return "the cells' overhang is not valid";
    return {};
}

std::string check_vertices(std::span<const float> vertices) {
    const bool right = all_right(vertices, [](float v) { return std::abs(v) <= 1e9f; });
    return right ? "" : "a vertex is not finite or beyond 10^9 mm";
}

std::string check_level_mesh(const LevelView& view) {
    const auto nv = static_cast<std::uint32_t>(view.vertices.size() / 3);
    const auto nf = static_cast<std::uint32_t>(view.faces.size() / 3);
    static_assert(kNoNeighbour + 1 == 0);  // so one comparison takes it and every triangle
    if (std::string reason = check_vertices(view.vertices); !reason.empty()) return reason;
    if (!all_right(view.normals, [](float v) { return std::abs(v) <= 1.01f; })) return "a normal is not a unit vector";
    if (!all_right(view.faces, [nv](std::uint32_t i) { return i < nv; })) return "a face index is out of range";
    if (!all_right(view.adjacency, [nf](std::uint32_t i) { return i + 1 <= nf; }))
        return "a neighbour index is out of range";
    return {};
}

std::string check_level_hash(const LevelView& view) {
    const HashHeader& h = *view.hash;
    std::uint64_t cells = 0;
    for (const Brick& b : view.bricks) {
        const std::int32_t at[3] = {b.x, b.y, b.z};
        for (int k = 0; k < 3; ++k)
            if (at[k] < h.brick_min[k] || at[k] > h.brick_max[k]) return "a brick lies outside the stated bounds";
        if (b.mask == 0 || b.first_cell != cells) return "a brick's cells are out of order";
        cells += static_cast<std::uint64_t>(std::popcount(b.mask));
    }
    if (cells != h.cell_count) return "the bricks do not own all cells";
    if (view.cells.front() != 0 || view.cells.back() != h.block_count) return "the cells do not own all blocks";
    for (std::size_t c = 0; c + 1 < view.cells.size(); ++c)
        if (view.cells[c] >= view.cells[c + 1]) return "a cell's blocks are out of order";
    std::uint32_t used = 0;
    for (std::size_t s = 0; s < view.table.size(); ++s) {
        if (view.table[s] == 0) continue;
        if (view.table[s] > h.brick_count) return "a hash slot is out of range";
        ++used;
    }
    if (used != h.brick_count) return "the hash table does not hold every brick once";
    for (std::uint32_t i = 0; i < h.brick_count; ++i) {
        const Brick& b = view.bricks[i];
        std::uint32_t slot = brick_hash(b.x, b.y, b.z) & (h.table_size - 1);
        while (view.table[slot] != 0 && view.table[slot] != i + 1) slot = (slot + 1) & (h.table_size - 1);
        if (view.table[slot] == 0) return "a brick cannot be found through the hash table";
    }
    return {};
}

std::string check_level_blocks(const LevelView& view, std::size_t first, std::size_t last) {
    const std::size_t nv = view.vertices.size() / 3, nf = view.faces.size() / 3;
    for (const TriBlock& block : view.blocks.subspan(first, last - first)) {
        if (block.id[0] >= nf) return "a block's first triangle is out of range";
        std::uint32_t differs = 0;
        for (int lane = 0; lane < 8; ++lane) {
            // Unused lanes repeat lane 0.
            const std::uint32_t id = block.id[lane] == kNoNeighbour ? block.id[0] : block.id[lane];
            if (id >= nf) return "a block's triangle is out of range";
            const std::uint32_t* face = &view.faces[3 * std::size_t{id}];
            for (int corner = 0; corner < 3; ++corner) {
                if (face[corner] >= nv) return "a face index is out of range";
                const float* at = &view.vertices[3 * std::size_t{face[corner]}];
                for (int k = 0; k < 3; ++k) differs |= block.v[3 * corner + k][lane] != at[k] ? 1u : 0u;
            }
        }
        if (differs != 0) return "a block's corners differ from the mesh";
    }
    return {};
}

std::string check_bounds(std::span<const TriBlock> blocks, std::span<const BlockBound> bounds) {
    for (std::size_t i = 0; i < blocks.size(); ++i) {
        const BlockBound& b = bounds[i];
        const double n[3] = {b.nx, b.ny, b.nz}, radius2 = double{b.radius} * double{b.radius}, half = b.half;
        const double unit = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
        // So written that what is not a number is refused.
        if (!(std::abs(unit - 1.0) <= 1e-5) || !(b.radius >= 0.0f) || !std::isfinite(b.radius) ||
            !std::isfinite(b.half))
            return "a block's bound is no disc";
        std::uint32_t outside = 0;
        for (int corner = 0; corner < 9; corner += 3) {
            for (int lane = 0; lane < 8; ++lane) {
                const double x = double{blocks[i].v[corner][lane]} - double{b.x};
                const double y = double{blocks[i].v[corner + 1][lane]} - double{b.y};
                const double z = double{blocks[i].v[corner + 2][lane]} - double{b.z};
                outside |= x * x + y * y + z * z <= radius2 ? 0u : 1u;
                outside |= std::abs(n[0] * x + n[1] * y + n[2] * z) <= half ? 0u : 1u;
            }
        }
        if (outside != 0) return "a block reaches beyond its bound";
    }
    return {};
}

}  // namespace hapticlod
