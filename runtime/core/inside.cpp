#include "core/inside.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/mapping.hpp"

namespace hapticlod {
namespace {

// A closest point found one triangle at a time, in double, takes as long as so many of the kernels' tests.
constexpr std::uint32_t kScalarTests = 3;
constexpr double kUnknown = 1e300;
constexpr double kFirstLook = 0.25;  // mean edges: most often the tool lies on the surface

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

// Takes in what a candidate knows of its ball's nearest surface point.
void look_closer(ContactSolver& solver, std::uint32_t i, BallSide& s, double kept, double same,
                 TickCounters& counters) {
    const Candidates& candidates = solver.candidates();
    if (candidates.key(i) + kept > s.distance + same) return;
    const EvalBlock& seen = solver.look(i, counters);
    const double rounding = 0.1 * solver.tolerances().skin;  // of the kernels
    for (std::uint32_t k = 0; k < 8; ++k) {
        if (double{seen.clearance[k]} + kept > s.distance + same + rounding) continue;
        counters.tests += kScalarTests;
        const Triangle t = candidates.triangle(i, k);
        const ClosestPoint p = closest_on_triangle({}, t);
        const double distance = std::sqrt(p.distance2);
        if (distance > s.distance + same) continue;
        if (distance < s.distance - same) s.distance = distance, s.point = p.point, s.normal = {}, s.around = 0;
        // Each triangle counts once, though candidates may repeat it.
        const auto last = s.counted.begin() + s.around;
        const std::uint64_t id = std::uint64_t{candidates.part(i)} << 32 | candidates.triangle_id(i, k);
        if (s.around < BallSide::kMostAround && std::find(s.counted.begin(), last, id) == last) {
            s.counted[s.around++] = id;
            s.normal += weighted_normal(t, p, same * same);
        }
        s.distance = std::min(s.distance, distance);
    }
}

// Every ball's nearest surface point among the candidates; returns how many balls have one.
std::size_t nearest_points(ContactSolver& solver, std::span<const SolverBall> balls, double same,
                           TickCounters& counters) {
    const Candidates& candidates = solver.candidates();
    const std::span<BallSide> sides = solver.sides().first(balls.size());
    for (BallSide& s : sides) s.distance = kUnknown, s.around = 0, s.first = BallSide::kNone;
    counters.tests += candidates.block_count() / 16;  // bounds that are looked at, as in contact.cpp
    solver.begin_looking();
    for (std::uint32_t i = 0; i < candidates.block_count(); ++i) {
        BallSide& s = sides[candidates.ball(i)];
        if (s.first == BallSide::kNone || candidates.key(i) < candidates.key(s.first)) s.first = i;
    }
    std::size_t found = 0;
    for (std::size_t b = 0; b < balls.size(); ++b) {
        if (sides[b].first == BallSide::kNone) continue;
        look_closer(solver, sides[b].first, sides[b], balls[b].kept, same, counters);
        ++found;
    }
    for (std::uint32_t i = 0; i < candidates.block_count(); ++i) {
        const std::uint32_t ball = candidates.ball(i);
        if (i != sides[ball].first) look_closer(solver, i, sides[ball], balls[ball].kept, same, counters);
    }
    return found;
}

// Between the surface normal and the way from the nearest point to the ball: negative behind the surface.
double cosine(const BallSide& s) {
    const double lengths = norm(s.normal) * norm(s.point);
    return lengths > 0.0 ? -dot(s.point, s.normal) / lengths : 0.0;
}

// Which side of the surface every ball is on, as far as that is known: by its nearest point where that is among the
// candidates, which are complete up to this clearance. Balls whose room overlaps are on one side, for no surface runs
// between the centres of two balls of empty space that overlap: there the one counts that sees its side best. At an
// edge or a border a normal may say little. True: the deepest ball of all is among those with a point.
bool settle_sides(ContactSolver& solver, std::span<const SolverBall> balls, double complete, double front) {
    const std::span<BallSide> sides = solver.sides().first(balls.size());
    bool any = false;
    for (std::size_t b = 0; b < balls.size(); ++b) {
        BallSide& s = sides[b];
        const double least = balls[b].kept + complete;
        s.seen = s.distance > least ? 0.0 : cosine(s);
        s.empty = std::min(s.distance, least);
        any |= s.distance <= least;
    }
    if (!any || front == 0.0) return any;
    const auto spread = [&](std::size_t from, std::size_t to) {
        const double room = (sides[from].empty + sides[to].empty) * (1.0 - 1e-9);
        if (std::abs(sides[from].seen) > std::abs(sides[to].seen) &&
            norm2(balls[from].offset - balls[to].offset) < room * room)
            sides[to].seen = sides[from].seen;
    };
    const std::span<const ToolLink> links = solver.links().of(balls.size());
    for (std::size_t i = links.size(); i-- > 0;) spread(links[i].ball, links[i].to);
    for (const auto& [ball, to] : links) spread(to, ball);
    for (std::size_t b = 0; b < balls.size(); ++b)
        if (sides[b].distance > balls[b].kept + complete && !(sides[b].seen * front > 0.0)) return false;
    return true;
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
    // A bundle may claim edges without length: twice nothing would never reach the bound.
    const double first = std::max(kFirstLook * solver.mean_edge_mm(), same);
    for (double c = std::min(first, bound_mm);; c = std::min(2.0 * c, bound_mm)) {
        const double granted = solver.gather(c, balls, counters);
        found = nearest_points(solver, balls, same, counters);
        if (found > 0 && (settle_sides(solver, balls, granted, front) || c >= size)) break;
        if (granted < c || c >= bound_mm) break;
    }
    candidates.invalidate();
    SurfaceSide side;
    double least = kUnknown;
    for (std::uint32_t b = 0; found > 0 && b < balls.size(); ++b) {
        const BallSide& s = solver.sides()[b];
        if (s.distance == kUnknown) continue;
        const double length = norm(s.normal), facing = cosine(s);
        const double sign = (s.seen != 0.0 ? s.seen : facing) < 0.0 ? -1.0 : 1.0;
        const double distance = sign * s.distance;
        // A normal that says otherwise is none to go by.
        const Vec3 normal = length > 0.0 && sign * facing >= 0.0 ? s.normal * (1.0 / length)
                                                                 : s.point * (-sign / std::max(norm(s.point), 1e-300));
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
