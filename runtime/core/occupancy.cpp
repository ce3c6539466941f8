#include "core/occupancy.hpp"

#include <cmath>

namespace hapticlod {

void Occupancy::build(const LevelView& level) {
    constexpr std::size_t kMostBits = std::size_t{1} << 24;  // 2 MB
    const HashHeader& h = *level.hash;
    for (shift_ = 0;; ++shift_) {
        std::size_t bits = 1;
        bool fits = true;
        for (int k = 0; k < 3; ++k) {
            size_[k] = static_cast<std::size_t>((std::int64_t{h.brick_max[k]} - h.brick_min[k]) >> shift_) + 1;
            fits = fits && bits <= kMostBits / size_[k];
            bits *= size_[k];
        }
        if (fits) break;
    }
    words_.assign((size_[0] * size_[1] * size_[2] + 63) / 64, 0);
    for (const Brick& b : level.bricks) {
        const std::size_t bit = row_of(level, b.y, b.z) + static_cast<std::size_t>((b.x - h.brick_min[0]) >> shift_);
        words_[bit >> 6] |= std::uint64_t{1} << (bit & 63);
    }
}

BlockBound bound_of(const TriBlock& block) {
    // The slab along the sum of the area normals; without one (a block folded onto itself) any direction serves.
    float sum[3] = {0.0f, 0.0f, 0.0f};
    for (int lane = 0; lane < 8; ++lane) {
        float u[3], v[3];
        for (int k = 0; k < 3; ++k)
            u[k] = block.v[3 + k][lane] - block.v[k][lane], v[k] = block.v[6 + k][lane] - block.v[k][lane];
        for (int k = 0; k < 3; ++k) sum[k] += u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3];
    }
    const float length = std::sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
    const bool directed = length > 0.0f && std::isfinite(length);
    BlockBound b{};
    b.nx = directed ? sum[0] / length : 1.0f, b.ny = directed ? sum[1] / length : 0.0f;
    b.nz = directed ? sum[2] / length : 0.0f;
    // The middle of the box along the normal and two directions across it, seen from the first corner.
    const float at[3] = {block.v[0][0], block.v[1][0], block.v[2][0]};
    const bool steep = std::abs(b.nz) > 0.7f;
    const float across = std::sqrt(steep ? b.nz * b.nz + b.ny * b.ny : b.nx * b.nx + b.ny * b.ny);
    const float u[3] = {steep ? 0.0f : -b.ny / across, steep ? -b.nz / across : b.nx / across,
                        steep ? b.ny / across : 0.0f};
    const float w[3] = {b.ny * u[2] - b.nz * u[1], b.nz * u[0] - b.nx * u[2], b.nx * u[1] - b.ny * u[0]};
    const float axes[3][3] = {{b.nx, b.ny, b.nz}, {u[0], u[1], u[2]}, {w[0], w[1], w[2]}};
    float lo[3] = {0.0f, 0.0f, 0.0f}, hi[3] = {0.0f, 0.0f, 0.0f}, size = 0.0f;
    for (int corner = 0; corner < 9; corner += 3)
        for (int lane = 0; lane < 8; ++lane) {
            float d[3];
            for (int k = 0; k < 3; ++k) {
                d[k] = block.v[corner + k][lane] - at[k];
                size = std::max(size, std::abs(block.v[corner + k][lane]));
            }
            for (int k = 0; k < 3; ++k) {
                const float along = axes[k][0] * d[0] + axes[k][1] * d[1] + axes[k][2] * d[2];
                lo[k] = std::min(lo[k], along), hi[k] = std::max(hi[k], along);
            }
        }
    float middle[3];
    for (int k = 0; k < 3; ++k) {
        middle[k] = at[k];
        for (int axis = 0; axis < 3; ++axis) middle[k] += 0.5f * (lo[axis] + hi[axis]) * axes[axis][k];
    }
    b.x = middle[0], b.y = middle[1], b.z = middle[2];
    float most = 0.0f;
    for (int corner = 0; corner < 9; corner += 3)
        for (int lane = 0; lane < 8; ++lane) {
            const float dx = block.v[corner][lane] - b.x, dy = block.v[corner + 1][lane] - b.y,
                        dz = block.v[corner + 2][lane] - b.z;
            most = std::max(most, dx * dx + dy * dy + dz * dz);
            b.half = std::max(b.half, std::abs(b.nx * dx + b.ny * dy + b.nz * dz));
        }
    // Outward, whatever the rounding.
    b.radius = std::sqrt(most) * 1.000001f + size * 1e-6f;
    b.half += b.radius * 1e-6f + size * 1e-6f;
    return b;
}

namespace {

// Whether every edge of every triangle has a neighbour. In pieces without an exit, which a compiler makes vectors of.
bool is_closed(std::span<const std::uint32_t> adjacency) {
    constexpr std::size_t kPiece = 4096;
    while (!adjacency.empty()) {
        const auto piece = adjacency.first(std::min(kPiece, adjacency.size()));
        std::uint32_t open = 0;
        for (const std::uint32_t neighbour : piece) open |= neighbour == kNoNeighbour ? 1u : 0u;
        if (open != 0) return false;
        adjacency = adjacency.subspan(piece.size());
    }
    return true;
}

}  // namespace

ActiveLevel::ActiveLevel(const LevelView& level)
    : view(level), bounds(level.bounds), closed(is_closed(level.adjacency)) {
    occupancy.build(level);
    if (bounds.size() == level.blocks.size()) return;
    made_bounds_.reserve(level.blocks.size());
    for (const TriBlock& block : level.blocks) made_bounds_.push_back(bound_of(block));
    bounds = made_bounds_;
}

}  // namespace hapticlod
