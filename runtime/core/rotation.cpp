// Turning the tool in contact. A rotation carries every ball along a chord; where a chord would pass through the
// surface, the reference point gives way by the least translation that keeps all balls on their side.
#include <algorithm>
#include <cmath>

#include "core/contact.hpp"

namespace hapticlod {
namespace {

constexpr int kRounds = 12;

bool already_there(const PlaneSet& set, const ContactPlane& plane, double same) {
    return std::any_of(set.planes.begin(), set.planes.begin() + set.count, [&](const ContactPlane& p) {
        return dot(p.normal, plane.normal) > 1.0 - 1e-9 && p.offset >= plane.offset - same;
    });
}

}  // namespace

bool ContactSolver::make_way(std::span<const SolverBall> balls, std::span<const Vec3> offsets, double motion_mm,
                             TickCounters& counters) {
    const double skin = tolerances_.skin;
    double longest = 0.0;
    for (std::size_t i = 0; i < balls.size(); ++i) longest = std::max(longest, norm(offsets[i] - balls[i].offset));
    // The shift may be as long as the turn; what the candidates hold beyond it serves the tick that follows.
    const double needed = 2.0 * longest + 8.0 * skin;
    if (!candidates_.valid() || norm(x_ - candidates_.centre()) + needed > candidates_.reach()) {
        if (gather(needed + longest + wanted_reach(motion_mm), balls, counters) < needed) return false;
    }
    local_ = x_ - candidates_.centre();
    next_stamp();
    // Unknown: the translation s of the reference point. A ball's chord is then its own turn plus s.
    PlaneSet planes;
    Vec3 shift;
    for (int round = 0; round < kRounds; ++round) {
        const int before = planes.count;
        const double shifted = norm(shift), most = longest + shifted + skin;
        for (std::uint32_t i = 0; i < candidates_.block_count(); ++i) {
            if (candidates_.key(i) - path_ > most) continue;
            if (candidates_.stamp(i) != stamp_) {
                const SolverBall& ball = balls[candidates_.ball(i)];
                if (candidates_.evaluated(i)) {
                    const double here = granted_here(i, ball);
                    const Vec3 to = local_ + offsets[candidates_.ball(i)] - ball.offset + shift;
                    if (here > most || (here > skin && kernels_->granted(candidates_.evaluation(i),
                                                                         move_since(i, to, ball).data()) > float(skin)))
                        continue;
                }
                renew(i, counters);
            }
            const EvalBlock& e = candidates_.evaluation(i);
            const std::uint32_t which = candidates_.ball(i);
            const SolverBall& ball = balls[which];
            const Vec3 turned = offsets[which] - ball.offset, chord = turned + shift;
            const double within = norm(chord) + skin;
            for (std::uint32_t k = 0; k < 8; ++k) {
                if (double{e.clearance[k]} > within) continue;
                const Triangle t = candidates_.triangle(i, k);
                const double at = time_of_touch(t, local_, chord, ball.kept - 0.1 * skin, 0.02 * skin);
                if (at > 1.0) continue;
                const Vec3 p = local_ + chord * at;
                const ClosestPoint c = closest_on_triangle(p, t);
                const double d = std::sqrt(c.distance2);
                if (!(d > 0.0)) continue;
                const Vec3 n = (p - c.point) * (1.0 / d);
                const ContactPlane plane{n,
                                         dot(n, c.point - local_) + ball.kept - dot(n, turned),
                                         c.point,
                                         0.0,
                                         candidates_.triangle_id(i, k),
                                         which,
                                         i,
                                         static_cast<std::uint16_t>(k),
                                         candidates_.part(i)};
                if (already_there(planes, plane, 0.01 * skin)) continue;
                if (planes.count == kMaxPlanes) return false;
                planes.planes[planes.count++] = plane;
            }
        }
        if (planes.count == before) {
            place(x_ + shift);
            return true;
        }
        const PlaneSolution solution = nearest_feasible(planes, {}, false, 1e-3 * skin);
        if (!solution.feasible) return false;
        shift = solution.y;
        if (longest + norm(shift) > needed - skin) return false;
    }
    return false;
}

}  // namespace hapticlod
