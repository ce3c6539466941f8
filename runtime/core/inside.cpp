#include "core/inside.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/mapping.hpp"

namespace hapticlod {
namespace {

// A closest point found one triangle at a time, in double, takes as long as so many of the kernels' tests.
constexpr std::uint32_t kScalarTests = 3;

double corner_angle(const Vec3& at, const Vec3& u, const Vec3& v) {
    const Vec3 a = u - at, b = v - at;
    return std::atan2(norm(cross(a, b)), dot(a, b));
}

// Angle-weighted pseudonormal contribution of a triangle at its point c: a corner counts with its angle, an edge and
// the inside with a constant (both faces of an edge alike).
Vec3 weighted_normal(const Triangle& t, const ClosestPoint& c, double same2) {
    const Vec3 n = cross(t.b - t.a, t.c - t.a);
    const double length = norm(n);
    if (!(length > 0.0)) return {};
    double weight = 1.0;
    if (!c.interior) {
        if (norm2(c.point - t.a) <= same2)
            weight = corner_angle(t.a, t.b, t.c);
        else if (norm2(c.point - t.b) <= same2)
            weight = corner_angle(t.b, t.c, t.a);
        else if (norm2(c.point - t.c) <= same2)
            weight = corner_angle(t.c, t.a, t.b);
    }
    return n * (weight / length);
}

// Every ball's nearest surface point among the candidates; returns how many balls have one.
std::size_t nearest_points(ContactSolver& solver, std::span<const SolverBall> balls, double same,
                           TickCounters& counters) {
    Candidates& candidates = solver.candidates();
    const std::span<BallSide> sides = solver.sides().first(balls.size());
    for (BallSide& s : sides) s.distance = 1e300, s.around = 0;
    std::size_t found = 0;
    counters.tests += candidates.block_count() / 16;  // bounds that are looked at, as in contact.cpp
    for (std::uint32_t i = 0; i < candidates.block_count(); ++i) {
        const std::uint32_t ball = candidates.ball(i);
        BallSide& s = sides[ball];
        if (candidates.key(i) + balls[ball].kept > s.distance + same) continue;
        counters.tests += 8 * kScalarTests;
        for (std::uint32_t k = 0; k < 8; ++k) {
            const Triangle t = candidates.triangle(i, k);
            const ClosestPoint p = closest_on_triangle({}, t);
            const double distance = std::sqrt(p.distance2);
            if (distance > s.distance + same) continue;
            if (distance < s.distance - same) {
                found += s.distance == 1e300 ? 1 : 0;
                s.distance = distance, s.point = p.point, s.normal = {}, s.around = 0;
            }
            // Each triangle counts once, though candidates may repeat it.
            const auto last = s.counted.begin() + s.around;
            const std::uint32_t id = candidates.triangle_id(i, k);
            if (s.around < BallSide::kMostAround && std::find(s.counted.begin(), last, id) == last) {
                s.counted[s.around++] = id;
                s.normal += weighted_normal(t, p, same * same);
            }
            s.distance = std::min(s.distance, distance);
        }
    }
    return found;
}

}  // namespace

double segment_hit(const Vec3& p, const Vec3& q, const Triangle& t) {
    const Vec3 d = q - p, ab = t.b - t.a, ac = t.c - t.a;
    const Vec3 n = cross(ab, ac);
    const double slope = -dot(d, n);
    if (slope == 0.0) return 2.0;
    const Vec3 ap = p - t.a;
    const double s = dot(ap, n) / slope;
    if (!(s >= 0.0 && s <= 1.0)) return 2.0;
    const Vec3 m = cross(ap, d);
    const double v = dot(ac, m) / slope, w = -dot(ab, m) / slope;
    return v >= 0.0 && w >= 0.0 && v + w <= 1.0 ? s : 2.0;
}

SurfaceSide surface_side(ContactSolver& solver, std::span<const SolverBall> balls, double bound_mm,
                         TickCounters& counters, double front) {
    Candidates& candidates = solver.candidates();
    const Vec3 x = solver.position();
    const double same = 1e-3 * solver.tolerances().skin;
    // A ball on the other side of the surface than its fellows is no further from it than from them.
    double size = 0.0;
    for (const SolverBall& ball : balls) size = std::max(size, norm(ball.offset - balls[0].offset));
    std::size_t found = 0;
    for (double c = std::min(solver.cell_mm(), bound_mm);; c = std::min(1.4 * c, bound_mm)) {
        const double granted = solver.gather(c, balls, counters);
        found = nearest_points(solver, balls, same, counters);
        if (found == balls.size() || (found > 0 && c >= size) || granted < c || c >= bound_mm) break;
    }
    candidates.invalidate();
    SurfaceSide side;
    double least = 1e300;
    for (std::uint32_t b = 0; found > 0 && b < balls.size(); ++b) {
        const BallSide& s = solver.sides()[b];
        if (s.distance == 1e300) continue;
        const double length = norm(s.normal);
        const Vec3 away = s.point * -1.0;
        const Vec3 normal = length > 0.0 ? s.normal * (1.0 / length) : away * (1.0 / std::max(norm(away), 1e-300));
        const double distance = dot(away, normal) < 0.0 ? -s.distance : s.distance;
        const double clear = (front == 0.0 ? s.distance : front * distance) - balls[b].kept;
        if (clear >= least) continue;
        least = clear;
        side = {true, distance, s.point + balls[b].offset + x, normal, b};
    }
    return side;
}

namespace {

// Frees the deepest ball again and again. In a groove the walls take turns; jointly: each push keeps free what the
// pushes before it freed, the least way out of all their planes.
bool push_out(ContactSolver& solver, std::span<const SolverBall> balls, double bound_mm, const ContactMemory* memory,
              bool jointly, bool sided, TickCounters& counters) {
    const Vec3 start = solver.position();
    const double skin = solver.tolerances().skin;
    // Out on the side that was touched. Where one side is as good as the other that holds for the first push alone: in
    // a narrow groove a wall may well face against the force.
    double front = memory != nullptr ? memory->side : 1.0;
    PlaneSet planes;
    for (int k = 0; k <= (jointly ? kMaxPlanes : 32); ++k) {
        const SurfaceSide side = surface_side(solver, balls, bound_mm, counters, sided ? front : 0.0);
        if (!side.found) break;
        const double kept = balls[side.ball].kept;
        const double distance = sided ? front * side.distance : std::abs(side.distance);
        if (k > 0 && distance - kept > -0.5 * skin) return true;
        if (jointly && planes.count == kMaxPlanes) break;
        const Vec3 normal = side.normal * front;
        Vec3 x = side.point + normal * kept - balls[side.ball].offset;
        if (jointly) {
            planes.planes[planes.count++] = {normal, dot(normal, x - start), side.point};
            const PlaneSolution least = nearest_feasible(planes, {}, false, 1e-3 * skin);
            if (!least.feasible) break;
            x = start + least.y;
        }
        if (norm(x - start) > bound_mm + kept) break;
        solver.place(x);
        if (!sided) front = 1.0;
    }
    solver.place(start);
    return false;
}

}  // namespace

bool place_on_closest(ContactSolver& solver, std::span<const SolverBall> balls, double bound_mm,
                      const ContactMemory* memory, TickCounters& counters) {
    const auto pushed = [&](bool sided) {
        return push_out(solver, balls, bound_mm, memory, false, sided, counters) ||
               push_out(solver, balls, bound_mm, memory, true, sided, counters);
    };
    // A single ball that does not touch is on some side; of several one could be left behind. Around an open border
    // that may be where it belongs.
    const bool several = balls.size() > 1;
    return pushed(several) || (several && !solver.closed() && pushed(false));
}

}  // namespace hapticlod
