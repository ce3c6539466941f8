#include "core/rotation.hpp"

#include <algorithm>
#include <cmath>

namespace hapticlod {
namespace {

constexpr int kRounds = 12;

bool already_there(const PlaneSet& set, const ContactPlane& plane, double same) {
    return std::any_of(set.planes.begin(), set.planes.begin() + set.count, [&](const ContactPlane& p) {
        return dot(p.normal, plane.normal) > 1.0 - 1e-9 && p.offset >= plane.offset - same;
    });
}

}  // namespace

bool make_way_for_turn(ContactSolver& solver, std::span<const SolverBall> balls, std::span<const Vec3> offsets,
                       TickCounters& counters) {
    Candidates& candidates = solver.candidates();
    const double skin = solver.tolerances().skin;
    double longest = 0.0;
    for (std::size_t i = 0; i < balls.size(); ++i) longest = std::max(longest, norm(offsets[i] - balls[i].offset));
    const double reach = 2.0 * longest + 8.0 * skin;
    if (candidates.gather(solver.position(), reach, balls, counters) < reach) return false;
    // Unknown: the translation s of the reference point. A ball's chord is then its own turn plus s.
    PlaneSet planes;
    Vec3 shift;
    for (int round = 0; round < kRounds; ++round) {
        const int before = planes.count;
        for (std::uint32_t i = 0; i < candidates.block_count(); ++i) {
            if (candidates.key(i) > longest + norm(shift)) continue;
            const ItemBlock& b = candidates.block(i);
            counters.tests += 8;
            for (std::uint32_t k = 0; k < 8; ++k) {
                const SolverBall& ball = balls[b.ball[k]];
                const Vec3 turned = offsets[b.ball[k]] - ball.offset, chord = turned + shift;
                const Triangle t = item_triangle(b, k);
                const double at = time_of_touch(t, {}, chord, ball.kept - 0.1 * skin, 0.02 * skin);
                if (at > 1.0) continue;
                const Vec3 p = chord * at;
                const ClosestPoint c = closest_on_triangle(p, t);
                const double d = std::sqrt(c.distance2);
                if (!(d > 0.0)) continue;
                const Vec3 n = (p - c.point) * (1.0 / d);
                const ContactPlane plane{
                    n, dot(n, c.point) + ball.kept - dot(n, turned), c.point, 0.0, b.triangle[k], b.ball[k], i, k};
                if (already_there(planes, plane, 0.01 * skin)) continue;
                if (planes.count == kMaxPlanes) return false;
                planes.planes[planes.count++] = plane;
            }
        }
        if (planes.count == before) {
            solver.place(solver.position() + shift);
            return true;
        }
        const PlaneSolution solution = nearest_feasible(planes, {}, false, 1e-3 * skin);
        if (!solution.feasible) return false;
        shift = solution.y;
        if (longest + norm(shift) > reach - skin) return false;
    }
    return false;
}

}  // namespace hapticlod
