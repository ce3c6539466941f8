// A point (or a ball of less than an edge) that lies on one face: the commonest tick of all. The step along a face's
// plane, and the proof that nothing rises above it, are those of sole_plane.cpp, but nothing is listed: when the foot
// leaves its face, the blocks about the way that the tool will go next are asked once, and the face below is proven
// along that way. What is not one plane is left to advance(), from wherever this has come to.
#include <algorithm>
#include <bit>
#include <cmath>

#include "core/contact.hpp"
#include "core/float_place.hpp"

namespace hapticlod {
namespace {

constexpr int kMostFaces = 4;      // of one tick
constexpr double kAhead = 1.1;     // a face is proven for so many ticks' motion
constexpr double kBeside = 0.1;    // and so many mean edges to the side of it
constexpr double kAbove = 0.1;     // mean edges: where a face ends, the next may lie so much lower
constexpr double kFarthest = 4.0;  // cells: a longer way holds too much
constexpr std::uint32_t kShortestPause = 2, kLongestPause = 128;  // ticks
constexpr std::uint32_t kNoBlock = 0xffffffffu;

}  // namespace

bool ContactSolver::ProvenFace::below(const Vec3& p) const {
    const Vec3 ap = p - corners.a;
    const double b = dot(weight_b, ap), c = dot(weight_c, ap);
    return b >= 0.0 && c >= 0.0 && b + c <= 1.0;
}

bool ContactSolver::ProvenFace::covers(const Vec3& p, double margin) const {
    const Vec3 to = p - place;
    const double t = std::clamp(dot(to, ahead) * ahead_inverse2, 0.0, 1.0), left = radius - margin;
    return left > 0.0 && norm2(to - ahead * t) <= left * left;
}

void ContactSolver::keep_face(std::uint32_t triangle, std::uint16_t part, const Triangle& t, const Vec3& towards) {
    const Vec3 ab = t.b - t.a, ac = t.c - t.a, n = cross(ab, ac);
    const double nn = norm2(n);
    if (!(nn > 0.0)) return;
    const double inverse = 1.0 / nn, unit = std::sqrt(inverse);
    face_.triangle = triangle, face_.part = part, face_.corners = t;
    face_.behind = dot(n, towards) < 0.0;
    face_.normal = n * (face_.behind ? -unit : unit);
    face_.weight_b = cross(ac, n) * inverse, face_.weight_c = cross(n, ab) * inverse;
}

// The face below `at`, where the ball's centre is, if nothing about the way ahead rises above it.
bool ContactSolver::find_face(const Vec3& at, const Vec3& ahead, const SolverBall& ball, TickCounters& counters) {
    const double touching = tolerances_.touching, length2 = norm2(ahead);
    const double room = kBeside * mean_edge_mm_ + 2.0 * touching;
    const Vec3 towards = face_.normal;
    ++looked_;
    face_.triangle = ProvenFace::kNoFace;
    if (!candidates_.around(at, ahead, room + ball.kept, around_, counters)) return false;
    const std::uint32_t count = around_.count;
    counters.tests += count / 8 + 1;
    alignas(32) float apart2[Candidates::Around::kMost];
    std::uint32_t bits[Candidates::Around::kMost / 8];
    std::uint16_t near[Candidates::Around::kMost];
    const FloatPlace centre(at);
    const float way[3] = {static_cast<float>(ahead.x), static_cast<float>(ahead.y), static_cast<float>(ahead.z)};
    const double inverse2 = length2 > 0.0 ? 1.0 / length2 : 0.0;
    kernels_->beside(around_.bounds.data(), count, centre.shift, way, static_cast<float>(inverse2),
                     static_cast<float>((room + ball.kept) * 1.00001), apart2, bits);
    const auto blocks = [&](std::uint32_t i) -> const TriBlock& { return *around_.blocks[i]; };
    std::uint32_t n = 0, first = 0;
    for (std::uint32_t b = 0; b < count; b += 8) {
        std::uint32_t group = bits[b / 8];
        if (count - b < 8) group &= (1u << (count - b)) - 1u;
        for (; group != 0; group &= group - 1) {
            const std::uint32_t i = b + static_cast<std::uint32_t>(std::countr_zero(group));
            const char* line = reinterpret_cast<const char*>(&blocks(i));
            for (std::size_t k = 0; k < sizeof(TriBlock); k += 64) __builtin_prefetch(line + k);
            if (n > 0 && apart2[i] < apart2[near[first]]) first = n;
            near[n++] = static_cast<std::uint16_t>(i);
        }
    }
    if (n == 0) return false;
    std::swap(near[0], near[first]);
    std::uint32_t block = kNoBlock, lane = 0;
    const double most = ball.kept + touching + kAbove * mean_edge_mm_;
    for (std::uint32_t k = 0; k < n && block == kNoBlock; ++k) {
        const BlockBound& bound = around_.bounds[near[k]];
        if (const float in = bound.radius + static_cast<float>(most); apart2[near[k]] * 0.999998f > in * in) continue;
        alignas(32) float height2[8];
        float nearest2 = static_cast<float>(most * most);
        counters.tests += 2;
        for (std::uint32_t facing = kernels_->facing(blocks(near[k]), centre.shift, centre.residual, height2);
             facing != 0; facing &= facing - 1) {
            const auto which = static_cast<std::uint32_t>(std::countr_zero(facing));
            if (height2[which] < nearest2) nearest2 = height2[which], block = near[k], lane = which;
        }
    }
    if (block == kNoBlock) return false;
    const TriBlock& own = blocks(block);
    const auto corner = [&](const TriBlock& in, std::uint32_t k, std::uint32_t which) {
        return Vec3{in.v[3 * k][which], in.v[3 * k + 1][which], in.v[3 * k + 2][which]};
    };
    const Triangle t{corner(own, 0, lane), corner(own, 1, lane), corner(own, 2, lane)};
    keep_face(own.id[lane] == kNoNeighbour ? own.id[0] : own.id[lane], around_.part[block], t, at - t.a);
    if (face_.triangle == ProvenFace::kNoFace) return false;
    const double height = dot(face_.normal, at - t.a);
    const auto give_up = [&] {
        face_.triangle = ProvenFace::kNoFace;
        return false;
    };
    if (!(height > 0.0) || height > most || !face_.below(at) || dot(face_.normal, towards) < 0.0) return give_up();
    const float margin = static_cast<float>(0.5 * tolerances_.covered);
    const FloatPlace foot(at - face_.normal * height);
    const float normal[3] = {static_cast<float>(face_.normal.x), static_cast<float>(face_.normal.y),
                             static_cast<float>(face_.normal.z)};
    double radius = room;
    bool whole = true;
    for (std::uint32_t k = 0; k < n; ++k) {
        ++counters.tests;
        const TriBlock& other = blocks(near[k]);
        std::uint32_t rising = kernels_->above(other, foot.shift, foot.residual, normal, margin);
        for (; rising != 0; rising &= rising - 1) {
            const auto which = static_cast<std::uint32_t>(std::countr_zero(rising));
            if (near[k] == block && which == lane) continue;
            ++counters.tests;
            const Triangle in_the_way{corner(other, 0, which), corner(other, 1, which), corner(other, 2, which)};
            const double clear = std::sqrt(closest_on_triangle(at, in_the_way).distance2) - ball.kept;
            radius = std::min(radius, clear * (1.0 - 1e-6));
            whole = false;
            if (radius <= 2.0 * touching) return give_up();
        }
    }
    face_.place = at, face_.radius = radius;
    face_.ahead = whole ? ahead : Vec3{};
    face_.ahead_inverse2 = whole ? inverse2 : 0.0;
    return true;
}

bool ContactSolver::glide(const Vec3& hip, const SolverBall& ball, const Vec3& motion, TickCounters& counters,
                          Contact& out) {
    if (face_.triangle == ProvenFace::kNoFace || ball.kept > mean_edge_mm_) return false;
    const std::uint32_t looked = looked_;
    if (paused_ > 0) --paused_;
    const bool done = glide_on(hip, ball, motion, counters, out);
    if (looked_ != looked) {
        // Where nothing stays a plane for long, looking for one is in vain: the more often it was, the longer not.
        pause_ = done ? std::max(pause_ / 2, kShortestPause) : std::min(2 * pause_, kLongestPause);
        if (!done) paused_ = pause_;
    }
    return done;
}

bool ContactSolver::glide_on(const Vec3& hip, const SolverBall& ball, const Vec3& motion, TickCounters& counters,
                             Contact& out) {
    const Vec3 target = hip + ball.offset;  // all places here are the ball's centre's
    const double least = 1e-3 * tolerances_.settled, slack = ball.kept - ball.radius, touching = tolerances_.touching;
    bool found_here = false;
    for (int k = 0; k < kMostFaces; ++k) {
        if (k > 0 && counters.work() > work_limit_) return false;
        const Vec3 at = x_ + ball.offset, normal = face_.normal;
        const double depth = ball.kept - dot(normal, target - face_.corners.a);
        if (depth <= least) return false;  // it lets go
        const Vec3 y = target + normal * depth;
        const auto look = [&](const Vec3& from, const Vec3& ahead) {
            return paused_ == 0 && norm2(ahead) <= kFarthest * kFarthest * cell_mm_ * cell_mm_ &&
                   find_face(from, ahead, ball, counters);
        };
        if (!found_here) {
            const double height = dot(normal, at - face_.corners.a);
            if (!(height > 0.0) || height - ball.kept > touching || !face_.below(at) || !face_.covers(at, touching) ||
                !face_.covers(y, touching)) {
                if (!look(at, (y - at) * kAhead)) return false;
                found_here = true;
                continue;
            }
        } else if (!face_.covers(y, touching)) {
            return false;
        }
        ++counters.iterations;
        ++counters.tests;
        const Vec3 step = y - at;
        x_ += step;
        path_ += norm(step);
        if (!face_.below(y)) {
            if (!look(y, (motion - normal * dot(normal, motion)) * kAhead)) return false;
            found_here = true;
            continue;
        }
        sole_ = true;
        const double pressed = depth - slack;
        out.converged = true;
        out.active = pressed > least ? 1 : 0;
        touched_ = out.active > 0;
        out.scp = touched_ ? hip + normal * pressed : hip;
        if (touched_) {
            const Vec3 foot = y - normal * ball.kept;
            out.planes[0] = {
                normal,    dot(normal, foot - ball.offset) + ball.kept, foot, slack, face_.triangle, 0, kNoBlock, 0,
                face_.part};
            out.multiplier[0] = pressed;
            out.behind[0] = face_.behind;
            last_touch_ = out.planes[0];
        }
        return true;
    }
    return false;
}

}  // namespace hapticlod
