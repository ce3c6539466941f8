// Eight-wide kernels, one source (kernels.inl) compiled twice: baseline x86-64 and AVX2. Both are compiled without
// contraction to fused multiply-add, so their results are equal bit for bit; the choice is made once, at load.
#pragma once
#include <cstdint>

#include "core/layout.hpp"

namespace hapticlod {

// What eval() says of a block's triangles seen from one place of a ball's centre, the origin: unit normals n away from
// the closest points, and clearances c = d - kept. While n.(y - origin) + c >= 0 the ball at y is clear of the
// triangle.
struct alignas(32) EvalBlock {
    float nx[8], ny[8], nz[8];
    float clearance[8];
    double origin[3];
    double unused;
};

// Up to eight balls of a tool, relative to a common point. `active` lanes are asked about.
struct alignas(32) BallPack {
    float x[8], y[8], z[8];
    float kept[8];
};

struct Kernels {
    const char* name;
    // Separating planes and clearances of a ball at shift + residual (the float nearest to its centre, and what that
    // leaves); returns the least clearance. Leaves the origin alone.
    float (*eval)(const TriBlock& block, const float shift[3], const float residual[3], float kept, EvalBlock& out);
    // Lower bounds of the clearance between each block and each ball: low[8 * block + lane]; bits[block] has a bit per
    // lane in `active` with a bound of at most `reach`. `least` (8) falls to the least bound beyond the reach.
    void (*near)(const BlockBound* bounds, std::uint32_t count, const BallPack& balls, const float centre[3],
                 std::uint32_t active, float reach, float* least, float* low, std::uint32_t* bits);
    // Lower bounds of the clearance between each block and one ball. Bounds are read and `low` is written up to the
    // next multiple of eight.
    void (*near_one)(const BlockBound* bounds, std::uint32_t count, const float centre[3], float kept, float* low);
    // Upper bounds of how far each block rises above the plane through the place. Reads and writes as near_one().
    void (*highest)(const BlockBound* bounds, std::uint32_t count, const float place[3], const float normal[3],
                    float* high);
    // Bit k of bits[b / 8]: bound b may come within that distance of the way from -> from + along; inverse2 is
    // 1 / |along|^2, or 0. apart2: squared distance of its middle from `from`. Reads and writes as near_one().
    void (*beside)(const BlockBound* bounds, std::uint32_t count, const float from[3], const float along[3],
                   float inverse2, float within, float* apart2, std::uint32_t* bits);
    // Bit k: seen from shift + residual along its normal, the nearest point of triangle k's plane is on the triangle;
    // height2[k] (8) is its squared distance.
    std::uint32_t (*facing)(const TriBlock& block, const float shift[3], const float residual[3], float* height2);
    // Bit k: triangle k rises by more than the margin above the plane through shift + residual.
    std::uint32_t (*above)(const TriBlock& block, const float shift[3], const float residual[3], const float normal[3],
                           float margin);
    // After the move (from the origin): the least clearance that the planes grant.
    float (*granted)(const EvalBlock& block, const float move[3]);
    // Bit k: after the move (from the origin) the plane of lane k does not keep the ball away by the margin.
    std::uint32_t (*crossed)(const EvalBlock& block, const float move[3], float margin);
};

[[nodiscard]] const Kernels& scalar_kernels() noexcept;
[[nodiscard]] const Kernels& best_kernels() noexcept;  // AVX2 where the processor has it

}  // namespace hapticlod
