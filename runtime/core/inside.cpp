#include "core/inside.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/mapping.hpp"

namespace hapticlod {
namespace {

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

// Least clearance over all candidates at x, in double.
double least_clearance(Candidates& candidates, const Vec3& x, std::span<const SolverBall> balls) {
    double least = 1e300;
    for (std::uint32_t i = 0; i < candidates.block_count(); ++i) {
        if (candidates.key(i) > least) continue;
        for (std::uint32_t k = 0; k < 8; ++k) {
            const double d2 = closest_on_triangle(x - candidates.centre(), candidates.triangle(i, k)).distance2;
            least = std::min(least, std::sqrt(d2) - balls[candidates.ball(i)].kept);
        }
    }
    return least;
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
    const double v = -dot(ac, m) / slope, w = dot(ab, m) / slope;
    return v >= 0.0 && w >= 0.0 && v + w <= 1.0 ? s : 2.0;
}

SurfaceSide surface_side(ContactSolver& solver, std::span<const SolverBall> balls, double bound_mm,
                         TickCounters& counters) {
    Candidates& candidates = solver.candidates();
    const Vec3 x = solver.position();
    const double same = 1e-3 * solver.tolerances().skin;
    SurfaceSide side;
    constexpr std::size_t kMostAround = 64;  // triangles around one vertex
    std::array<std::uint32_t, kMostAround> counted;
    std::size_t around = 0;
    for (double c = std::min(solver.cell_mm(), bound_mm);; c = std::min(1.4 * c, bound_mm)) {
        const double granted = solver.gather(c, balls, counters);
        double least = 1e300;
        for (std::uint32_t i = 0; i < candidates.block_count(); ++i) {
            if (candidates.key(i) > least + same) continue;
            counters.tests += 8;
            const std::uint32_t touched = candidates.ball(i);
            for (std::uint32_t k = 0; k < 8; ++k) {
                const ClosestPoint p = closest_on_triangle({}, candidates.triangle(i, k));
                const SolverBall& ball = balls[touched];
                const double clearance = std::sqrt(p.distance2) - ball.kept;
                if (clearance > least + same) continue;
                if (clearance < least - same) {
                    side = {true, std::sqrt(p.distance2), p.point + ball.offset + x, {}, touched};
                    around = 0;
                }
                // Each triangle counts once, though candidates may repeat it.
                const auto last = counted.begin() + static_cast<std::ptrdiff_t>(around);
                if (touched == side.ball && around < kMostAround &&
                    std::find(counted.begin(), last, candidates.triangle_id(i, k)) == last) {
                    counted[around++] = candidates.triangle_id(i, k);
                    side.normal += weighted_normal(candidates.triangle(i, k), p, same * same);
                }
                least = std::min(least, clearance);
            }
        }
        if (side.found || granted < c || c >= bound_mm) break;
    }
    candidates.invalidate();
    if (!side.found) return side;
    const Vec3 away = x + balls[side.ball].offset - side.point;
    const double length = norm(side.normal);
    side.normal = length > 0.0 ? side.normal * (1.0 / length) : away * (1.0 / std::max(norm(away), 1e-300));
    if (dot(away, side.normal) < 0.0) side.distance = -side.distance;
    return side;
}

namespace {

// Frees the deepest ball again and again. In a groove the walls take turns; jointly: each push keeps free what the
// pushes before it freed, the least way out of all their planes.
bool push_out(ContactSolver& solver, std::span<const SolverBall> balls, double bound_mm, const ContactMemory* memory,
              bool jointly, TickCounters& counters) {
    const Vec3 start = solver.position();
    const double skin = solver.tolerances().skin;
    PlaneSet planes;
    for (int k = 0; k < (jointly ? kMaxPlanes : 32); ++k) {
        const SurfaceSide side = surface_side(solver, balls, bound_mm, counters);
        if (!side.found) break;
        Vec3 normal = side.normal;
        // Out on the side that was touched: in a narrow groove a wall may well face against the force.
        if (memory != nullptr) normal = normal * memory->side;
        const double kept = balls[side.ball].kept;
        Vec3 x = side.point + normal * kept - balls[side.ball].offset;
        if (jointly) {
            planes.planes[planes.count++] = {normal, dot(normal, x - start), side.point};
            const PlaneSolution least = nearest_feasible(planes, {}, false, 1e-3 * skin);
            if (!least.feasible) break;
            x = start + least.y;
        }
        solver.place(x);
        solver.gather(4.0 * skin, balls, counters);
        const double clearance = least_clearance(solver.candidates(), x, balls);
        solver.candidates().invalidate();
        if (norm(x - start) > bound_mm + kept) break;
        if (clearance > -0.5 * skin) return true;
        memory = nullptr;  // after the first push the surface's own front is the way out
    }
    solver.place(start);
    return false;
}

}  // namespace

bool place_on_closest(ContactSolver& solver, std::span<const SolverBall> balls, double bound_mm,
                      const ContactMemory* memory, TickCounters& counters) {
    return push_out(solver, balls, bound_mm, memory, false, counters) ||
           push_out(solver, balls, bound_mm, memory, true, counters);
}

}  // namespace hapticlod
