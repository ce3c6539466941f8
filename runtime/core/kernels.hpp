// Eight-wide kernels, one source (kernels.inl) compiled twice: baseline x86-64 and AVX2. Both are compiled without
// contraction to fused multiply-add, so their results are equal bit for bit; the choice is made once, at load.
#pragma once
#include <cstdint>

#include "core/layout.hpp"

namespace hapticlod {

// Eight candidate triangles in the solver's frame, each inflated by the radius of the ball it was gathered for.
struct alignas(64) ItemBlock {
    float v[9][8];
    float radius[8];
    std::uint32_t triangle[8];
    std::uint32_t ball[8];
};

// What eval() says of eight items seen from one point: supporting plane n.y >= offset, and clearance d - radius.
struct alignas(32) EvalBlock {
    float nx[8], ny[8], nz[8];
    float offset[8];
    float clearance[8];
};

// Up to eight balls of a tool, relative to a common point. `active` lanes are asked about.
struct alignas(32) BallPack {
    float x[8], y[8], z[8];
    float kept[8];
};

// A block's triangles lie in this ball and in this slab: |p - centre| <= radius, |normal.(p - centre)| <= half. On a
// smooth surface the slab says almost exactly how far a ball is above it. Most blocks are passed over by this alone.
struct alignas(32) BlockBound {
    float x, y, z, radius;
    float nx, ny, nz, half;
};

struct Kernels {
    const char* name;
    // A stored block as items of one ball, relative to (shift + residual). shift is the float nearest to the ball's
    // centre, residual what it leaves.
    void (*place)(const TriBlock& block, const float shift[3], const float residual[3], float radius, ItemBlock& out);
    // Separating planes and clearances from p; returns the least clearance.
    float (*eval)(const ItemBlock& block, const float p[3], EvalBlock& out);
    // Lower bounds of the clearance between each block and each ball: low[8 * block + lane]; bits[block] has a bit per
    // lane in `active` with a bound of at most `reach`. `least` (8) falls to the least bound beyond the reach.
    void (*near)(const BlockBound* bounds, std::uint32_t count, const BallPack& balls, const float centre[3],
                 std::uint32_t active, float reach, float* least, float* low, std::uint32_t* bits);
    // Bit k: the plane of lane k does not keep y away, n.y - offset < margin.
    std::uint32_t (*crossed)(const EvalBlock& block, const float y[3], float margin);
};

[[nodiscard]] const Kernels& scalar_kernels() noexcept;
[[nodiscard]] const Kernels& best_kernels() noexcept;  // AVX2 where the processor has it

}  // namespace hapticlod
