// The common case of a contact's step: one ball, held by one plane. What contact.cpp does for any tool and any number
// of planes is done here for this case alone, with the same result: the same nearest triangle, its plane in double
// precision, and instead of a sweep the proof that none is needed: every other triangle near the step lies behind that
// plane. Where the proof fails the general way is taken. A triangle behind the plane through the nearest point of
// another is no nearer than that one, so the proof says at the same time that the right one was found, however.
// A face stays proven around the place where it was: the next tick's first step mostly needs nothing but it.
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "core/contact.hpp"
#include "core/float_place.hpp"
#include "core/surface.hpp"

namespace hapticlod {
namespace {

constexpr std::uint32_t kMostBlocks = 256;
constexpr std::uint32_t kNone = 0xffffffffu;

// Indices of the bounds that are at most this.
std::uint32_t select(const float* low, std::uint32_t count, float most, std::uint16_t* chosen) {
    std::uint32_t n = 0;
    for (std::uint32_t i = 0; i < count; ++i) {
        chosen[n] = static_cast<std::uint16_t>(i);
        n += low[i] <= most ? 1u : 0u;
    }
    return n;
}

Triangle operator-(const Triangle& t, const Vec3& at) { return {t.a - at, t.b - at, t.c - at}; }

// How far the reference point at `from` would go along a plane if nothing else were there.
double way_along(const Vec3& normal, double offset, const Vec3& from, const Vec3& target) {
    const Vec3 y = target + normal * std::max(offset - dot(normal, target), 0.0);
    return norm(y - from) * (1.0 + 1e-9);
}

}  // namespace

// As an obstacle of the reference point, relative to the candidates' centre.
Triangle ContactSolver::triangle_of(const ContactPlane& plane, const SolverBall& ball) const {
    if (plane.block != kNone) return candidates_.triangle(plane.block, plane.lane);
    const Vec3 at = candidates_.centre() + ball.offset;
    const bool proven = plane.triangle == face_.triangle && plane.part == face_.part;
    return (proven ? face_.corners : level_triangle(candidates_.level().surfaces[plane.part]->view, plane.triangle)) -
           at;
}

bool ContactSolver::on_proven_face(std::span<const SolverBall> balls, const Vec3& target, TickCounters& counters) {
    proven_ = 0.0;
    if (face_.triangle == ProvenFace::kNoFace || balls.size() != 1) return false;
    const SolverBall& ball = balls[0];
    const Vec3 at = candidates_.centre() + ball.offset;
    const double left = face_.radius - norm(at + local_ - face_.place) - tolerances_.touching;
    if (!(left > 0.0)) return false;
    ++counters.tests;
    const ClosestPoint c = closest_on_triangle(local_, face_.corners - at);
    const double d = std::sqrt(c.distance2);
    if (!c.interior || !(d > 0.0) || d - ball.kept > tolerances_.touching) return false;
    const Vec3 n = (local_ - c.point) * (1.0 / d);
    const double offset = dot(n, c.point) + ball.kept;
    if (dot(n, face_.normal) < 0.0 || way_along(n, offset, local_, target) > left) return false;
    planes_.planes[0] = {n, offset,    c.point + ball.offset, ball.kept - ball.radius, face_.triangle, 0, kNone,
                         0, face_.part};
    planes_.count = 1;
    proven_ = left;
    return true;
}

bool ContactSolver::find_sole_plane(std::span<const SolverBall> balls, const Vec3& target, double ahead_mm,
                                    TickCounters& counters) {
    proven_ = 0.0;
    sole_ = false;
    face_.triangle = ProvenFace::kNoFace;  // its normal is still a guess
    const std::uint32_t count = candidates_.block_count();
    if (balls.size() != 1 || count > kMostBlocks) return false;
    const SolverBall& ball = balls[0];
    const Vec3 at = candidates_.centre() + ball.offset;
    const FloatPlace centre(at + local_);
    alignas(32) std::array<float, kMostBlocks> low;
    std::array<std::uint16_t, kMostBlocks> chosen;
    kernels_->near_one(candidates_.listed_bounds(), count, centre.shift, static_cast<float>(ball.kept), low.data());
    counters.tests += count / 8 + 1;
    const float touching = static_cast<float>(tolerances_.touching);
    const std::uint32_t close = select(low.data(), count, touching, chosen.data());
    const auto lower_keys = [&] {
        for (std::uint32_t i = 0; i < count; ++i)
            candidates_.key(i) = std::max(candidates_.key(i), path_ + double{low[i]});
    };
    // What is not listed is beyond this.
    const double complete = candidates_.reach() - norm(local_) - tolerances_.skin;
    if (close == 0) {  // in the air
        lower_keys();
        double least = complete;
        for (std::uint32_t i = 0; i < count; ++i) least = std::min(least, double{low[i]});
        planes_.count = 0;
        proven_ = std::max(least - tolerances_.skin, 0.0);
        return true;
    }
    // The triangle below, in the direction of the last face: the block whose middle is nearest to that place first.
    std::uint32_t block = kNone, lane = 0;
    const FloatPlace below(at + local_ - face_.normal * ball.kept);
    const BlockBound* bounds = candidates_.listed_bounds();
    const auto apart2 = [&](const BlockBound& b) {
        const float x = b.x - below.shift[0], y = b.y - below.shift[1], z = b.z - below.shift[2];
        return x * x + y * y + z * z;
    };
    std::uint32_t first = 0;
    float least2 = apart2(bounds[chosen[0]]);
    for (std::uint32_t k = 1; k < close; ++k)
        if (const float other2 = apart2(bounds[chosen[k]]); other2 < least2) least2 = other2, first = k;
    std::swap(chosen[0], chosen[first]);
    const float most2 = static_cast<float>((ball.kept + tolerances_.touching) * (ball.kept + tolerances_.touching));
    for (std::uint32_t k = 0; k < close && block == kNone; ++k) {
        alignas(32) float height2[8];
        const std::uint32_t i = chosen[k];
        float nearest2 = most2;
        counters.tests += 2;
        for (std::uint32_t bits = kernels_->facing(candidates_.triangles(i), centre.shift, centre.residual, height2);
             bits != 0; bits &= bits - 1) {
            const auto which = static_cast<std::uint32_t>(std::countr_zero(bits));
            if (height2[which] < nearest2) nearest2 = height2[which], block = i, lane = which;
        }
    }
    if (block == kNone) {  // over an edge or a corner
        float clearance = touching;
        for (std::uint32_t k = 0; k < close; ++k) {
            if (candidates_.stamp(chosen[k]) != stamp_) renew(chosen[k], counters);
            const EvalBlock& e = candidates_.evaluation(chosen[k]);
            for (std::uint32_t which = 0; which < 8; ++which)
                if (e.clearance[which] < clearance) clearance = e.clearance[which], block = chosen[k], lane = which;
        }
    }
    const auto give_up = [&] {
        lower_keys();
        return false;
    };
    if (block == kNone) return give_up();
    const Triangle triangle = candidates_.triangle(block, lane);
    const ClosestPoint c = closest_on_triangle(local_, triangle);
    const double d = std::sqrt(c.distance2);
    if (!(d > 0.0) || d - ball.kept > tolerances_.touching) return give_up();
    const Vec3 n = (local_ - c.point) * (1.0 / d);
    const double offset = dot(n, c.point) + ball.kept;
    const double wanted = std::max(way_along(n, offset, local_, target), ahead_mm) + tolerances_.touching;
    // As far as everything is listed and nothing but the triangle itself rises above its plane.
    double radius = std::min(wanted, complete);
    const float margin = static_cast<float>(0.5 * tolerances_.covered);
    const FloatPlace foot(at + c.point);
    const float normal[3] = {static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)};
    alignas(32) std::array<float, kMostBlocks> high;
    kernels_->highest(candidates_.listed_bounds(), count, foot.shift, normal, high.data());
    std::uint32_t around = 0;
    for (std::uint32_t i = 0; i < count; ++i) {
        chosen[around] = static_cast<std::uint16_t>(i);
        around += std::uint32_t{low[i] <= static_cast<float>(radius)} & std::uint32_t{high[i] > margin};
    }
    for (std::uint32_t k = 0; k < around; ++k) candidates_.fetch(chosen[k]);
    for (std::uint32_t k = 0; k < around; ++k) {
        const std::uint32_t i = chosen[k];
        ++counters.tests;
        std::uint32_t bits = kernels_->above(candidates_.triangles(i), foot.shift, foot.residual, normal, margin);
        if (bits == 0) continue;
        if (candidates_.stamp(i) != stamp_) renew(i, counters);
        const EvalBlock& e = candidates_.evaluation(i);
        for (; bits != 0; bits &= bits - 1) {
            const auto which = static_cast<std::uint32_t>(std::countr_zero(bits));
            if (!(i == block && which == lane)) radius = std::min(radius, double{e.clearance[which]} * (1.0 - 1e-6));
        }
        if (radius <= 2.0 * tolerances_.touching) return give_up();
    }
    planes_.planes[0] = {n,
                         offset,
                         c.point + ball.offset,
                         ball.kept - ball.radius,
                         candidates_.triangle_id(block, lane),
                         0,
                         block,
                         static_cast<std::uint16_t>(lane),
                         candidates_.part(block)};
    planes_.count = 1;
    sole_ = true;
    proven_ = radius - tolerances_.touching;
    if (way_along(n, offset, local_, target) > proven_) lower_keys();  // it will be swept
    if (c.interior) {
        keep_face(planes_.planes[0].triangle, planes_.planes[0].part,
                  {triangle.a + at, triangle.b + at, triangle.c + at}, n);
        face_.place = at + local_, face_.ahead = {}, face_.ahead_inverse2 = 0.0, face_.radius = radius;
    }
    return true;
}

}  // namespace hapticlod
