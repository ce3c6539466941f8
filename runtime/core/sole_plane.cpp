// The common case of a contact's step: one ball, held by one plane. What contact.cpp does for any tool and any number
// of planes is done here for this case alone, with the same result: the same nearest triangle, its plane in double
// precision, and instead of a sweep the proof that none is needed: every other triangle near the step lies behind that
// plane. Where the proof fails the general way is taken. A triangle behind the plane through the nearest point of
// another is no nearer than that one, so the proof says at the same time that the right one was found, however.
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "core/contact.hpp"

namespace hapticlod {
namespace {

constexpr std::uint32_t kMostBlocks = 256;
constexpr std::uint32_t kNone = 0xffffffffu;

struct FloatPlace {
    float shift[3], residual[3];

    explicit FloatPlace(const Vec3& p) {
        const double at[3] = {p.x, p.y, p.z};
        for (int k = 0; k < 3; ++k) {
            shift[k] = static_cast<float>(at[k]);
            residual[k] = static_cast<float>(at[k] - double{shift[k]});
        }
    }
};

}  // namespace

bool ContactSolver::find_sole_plane(std::span<const SolverBall> balls, const Vec3& target, TickCounters& counters) {
    proven_ = 0.0;
    const std::uint32_t count = candidates_.block_count();
    if (balls.size() != 1 || count > kMostBlocks) return false;
    const SolverBall& ball = balls[0];
    const Vec3 offset = candidates_.centre() + ball.offset;
    const FloatPlace centre(offset + local_);
    alignas(32) std::array<float, kMostBlocks> low;
    kernels_->near_one(candidates_.listed_bounds(), count, centre.shift, static_cast<float>(ball.kept), low.data());
    counters.tests += count / 8 + 1;
    const float touching = static_cast<float>(tolerances_.touching);
    float least = std::numeric_limits<float>::max();
    for (std::uint32_t i = 0; i < count; ++i) {
        candidates_.key(i) = std::max(candidates_.key(i), path_ + double{low[i]});
        least = std::min(least, low[i]);
    }
    planes_.count = 0;
    if (least > touching) {  // in the air
        proven_ = std::max(double{least} - tolerances_.skin, 0.0);
        return true;
    }
    std::uint32_t block = kNone, lane = 0;
    ClosestPoint c;
    // Still over the triangle that was touched last?
    for (std::uint32_t i = 0; i < count; ++i) {
        if (candidates_.block(i) != sole_block_ || low[i] > touching) continue;
        c = closest_on_triangle(local_, candidates_.triangle(i, sole_lane_));
        const double most = ball.kept + tolerances_.touching;
        if (c.interior && c.distance2 <= most * most) block = i, lane = sole_lane_;
        ++counters.tests;
        break;
    }
    if (block == kNone) {
        float nearest2 = std::numeric_limits<float>::max();
        for (std::uint32_t i = 0; i < count; ++i) {
            if (low[i] > touching) continue;
            alignas(32) float height2[8];
            counters.tests += 2;
            for (std::uint32_t bits =
                     kernels_->facing(candidates_.triangles(i), centre.shift, centre.residual, height2);
                 bits != 0; bits &= bits - 1) {
                const auto k = static_cast<std::uint32_t>(std::countr_zero(bits));
                if (height2[k] < nearest2) nearest2 = height2[k], block = i, lane = k;
            }
        }
        if (block == kNone) {  // over an edge or a corner
            float clearance = touching;
            for (std::uint32_t i = 0; i < count; ++i) {
                if (low[i] > touching) continue;
                if (candidates_.stamp(i) != stamp_) renew(i, counters);
                const EvalBlock& e = candidates_.evaluation(i);
                for (std::uint32_t k = 0; k < 8; ++k)
                    if (e.clearance[k] < clearance) clearance = e.clearance[k], block = i, lane = k;
            }
            if (block == kNone) return false;
        }
        c = closest_on_triangle(local_, candidates_.triangle(block, lane));
        sole_block_ = candidates_.block(block), sole_lane_ = lane;
    }
    const double d = std::sqrt(c.distance2);
    if (!(d > 0.0) || d - ball.kept > tolerances_.touching) return false;
    const Vec3 n = (local_ - c.point) * (1.0 / d);
    const double plane_offset = dot(n, c.point) + ball.kept;
    // As far as the ball would go if nothing else were there.
    const Vec3 y = target + n * std::max(plane_offset - dot(n, target), 0.0);
    const double length = norm(y - local_) * (1.0 + 1e-9);
    const float within = static_cast<float>((length + tolerances_.touching) * (1.0 + 1e-6));
    const float margin = static_cast<float>(0.5 * tolerances_.covered);
    const FloatPlace foot(offset + c.point);
    const float normal[3] = {static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)};
    for (std::uint32_t i = 0; i < count; ++i) {
        if (low[i] > within) continue;
        ++counters.tests;
        std::uint32_t bits = kernels_->above(candidates_.triangles(i), foot.shift, foot.residual, normal, margin);
        if (bits == 0) continue;
        if (candidates_.stamp(i) != stamp_) renew(i, counters);
        const EvalBlock& e = candidates_.evaluation(i);
        for (; bits != 0; bits &= bits - 1) {
            const auto k = static_cast<std::uint32_t>(std::countr_zero(bits));
            if (e.clearance[k] <= within && !(i == block && k == lane)) return false;
        }
    }
    planes_.planes[0] = {n, plane_offset, c.point + ball.offset, ball.kept - ball.radius,
                         candidates_.triangle_id(block, lane), 0, block, lane};
    planes_.count = 1;
    proven_ = length;
    return true;
}

}  // namespace hapticlod
