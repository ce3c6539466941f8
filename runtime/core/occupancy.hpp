// Which bricks hold anything: one bit per brick (or per 2^k bricks of a very large level), so that empty space is
// crossed without touching the hash. Made when a level is bound; a few kilobytes.
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/kernels.hpp"
#include "core/level.hpp"

namespace hapticlod {

class Occupancy {
public:
    void build(const LevelView& level);

    // Calls visit(brick) for every occupied brick with lo <= coordinates <= hi; stops where it returns false.
    // Returns the number of bricks looked up in the hash.
    template <class Visit>
    std::uint32_t for_bricks(const LevelView& level, const std::int32_t lo[3], const std::int32_t hi[3],
                             Visit&& visit) const {
        std::uint32_t lookups = 0;
        std::int32_t from[3], to[3];
        for (int k = 0; k < 3; ++k) {
            from[k] = std::max(lo[k], level.hash->brick_min[k]);
            to[k] = std::min(hi[k], level.hash->brick_max[k]);
            if (from[k] > to[k]) return 0;
        }
        for (std::int32_t z = from[2]; z <= to[2]; ++z)
            for (std::int32_t y = from[1]; y <= to[1]; ++y) {
                const std::size_t row = row_of(level, y, z);
                for (std::int32_t x = from[0]; x <= to[0]; ++x) {
                    const std::size_t bit = row + static_cast<std::size_t>((x - level.hash->brick_min[0]) >> shift_);
                    if ((words_[bit >> 6] >> (bit & 63) & 1) == 0) continue;
                    ++lookups;
                    const Brick* brick = find_brick(level, x, y, z);
                    if (brick != nullptr && !visit(*brick)) return lookups;
                }
            }
        return lookups;
    }

    [[nodiscard]] std::size_t bytes() const { return words_.size() * sizeof(std::uint64_t); }

private:
    [[nodiscard]] std::size_t row_of(const LevelView& level, std::int32_t y, std::int32_t z) const {
        const auto at = [&](std::int32_t v, int k) {
            return static_cast<std::size_t>((v - level.hash->brick_min[k]) >> shift_);
        };
        return (at(z, 2) * size_[1] + at(y, 1)) * size_[0];
    }

    std::vector<std::uint64_t> words_;
    std::size_t size_[3] = {0, 0, 0};
    int shift_ = 0;
};

[[nodiscard]] BlockBound bound_of(const TriBlock& block);

// A level as the tick uses it: the stored arrays, and what is cheap enough to make anew when it is loaded.
struct ActiveLevel {
    LevelView view;
    Occupancy occupancy;
    std::span<const BlockBound> bounds;  // one per block: the stored ones, or those made here
    bool closed = false;                 // no open border: what is behind the surface is inside

    explicit ActiveLevel(const LevelView& level);
    ActiveLevel(ActiveLevel&&) = default;  // made bounds stay where they are
    ActiveLevel& operator=(ActiveLevel&&) = default;
    [[nodiscard]] std::size_t bytes() const { return occupancy.bytes() + bounds.size_bytes(); }

private:
    std::vector<BlockBound> made_bounds_;
};

}  // namespace hapticlod
