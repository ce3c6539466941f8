// Content checks of a level that comes from a file: after them, the tick may trust every index.
#include <bit>
#include <cmath>

#include "core/level.hpp"
#include "core/material.hpp"
#include "core/morton.hpp"

namespace hapticlod {

std::string check_level(const LevelView& view) {
    if (view.hash == nullptr) return "the hash header is missing";
    const HashHeader& h = *view.hash;
    const std::size_t nv = view.vertices.size() / 3, nf = view.faces.size() / 3;
    if (nv == 0 || view.vertices.size() % 3 != 0) return "the vertex array is empty or not in threes";
    if (nf == 0 || view.faces.size() % 3 != 0) return "the face array is empty or not in threes";
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
    for (const float v : view.vertices)
        if (!std::isfinite(v)) return "a vertex is not finite";
    for (const float v : view.normals)
        if (!(std::abs(v) <= 1.01f)) return "a normal is not a unit vector";
    for (const std::uint32_t i : view.faces)
        if (i >= nv) return "a face index is out of range";
    for (const std::uint32_t i : view.adjacency)
        if (i >= nf && i != kNoNeighbour) return "a neighbour index is out of range";
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
    for (const TriBlock& block : view.blocks) {
        if (block.id[0] >= nf) return "a block's first triangle is out of range";
        for (int lane = 0; lane < 8; ++lane) {
            if (block.id[lane] >= nf && block.id[lane] != kNoNeighbour) return "a block's triangle is out of range";
            const std::uint32_t* face = &view.faces[3 * std::size_t{block.id[block.id[lane] < nf ? lane : 0]}];
            for (int row = 0; row < 9; ++row)
                if (block.v[row][lane] != view.vertices[3 * std::size_t{face[row / 3]} + row % 3])
                    return "a block's corners differ from the mesh";
        }
    }
    return check_materials(view.materials, nv);
}

}  // namespace hapticlod
