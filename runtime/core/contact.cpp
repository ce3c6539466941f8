#include "core/contact.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace hapticlod {
namespace {

constexpr int kMaxIterations = 64;
// A long slide over many small constraints settles slowly: from this iteration on a step counts as settled that is
// longer each time, up to a hundred times (below 1 um on models up to 120 mm).
constexpr int kPatience = 10;
constexpr double kShortStep = 0.1;  // mean edges; before patience ends a third of it
// Candidates are gathered about the place that the reference point will reach in so many ticks, with this room around.
constexpr double kTicksAhead = 1.0;
constexpr double kRoom = 0.15;        // mean edges
constexpr double kAheadOfFace = 1.3;  // a face is proven for so many ticks' motion

// Sliding over a rounded edge converges linearly, slowly where the HIP is near the centre of curvature. Successive
// steps in one direction tell the rate (Aitken), and a short step is stretched to where they lead; it is swept all the
// same. A long one is not, nor does a stretched one become longer than a short one may be: it could leap over the
// minimum it would have come to, and round an open border behind that.
class Slide {
public:
    double stretch(const Vec3& step, double length) {
        if (last_length_ > 0.0 && dot(step, last_) > 0.9 * length * last_length_) {
            const double ratio = length / last_length_;
            if (++run_ >= 3) stretch_ = std::min(ratio < 1.0 ? stretch_ / (1.0 - ratio) : 2.0 * stretch_, 64.0);
        } else {
            stretch_ = 1.0;
            run_ = 0;
        }
        last_ = step;
        last_length_ = length;
        return stretch_;
    }

private:
    Vec3 last_;
    double last_length_ = 0.0, stretch_ = 1.0;
    int run_ = 0;
};

}  // namespace

double time_of_touch(const Triangle& triangle, const Vec3& p, const Vec3& step, double keep, double precision) {
    double t = 0.0;
    for (int k = 0; k < 48; ++k) {
        const Vec3 at = p + step * t;
        const ClosestPoint c = closest_on_triangle(at, triangle);
        const double d = std::sqrt(c.distance2);
        const double gap = d - keep;
        const double slope = d > 0.0 ? dot(at - c.point, step) / d : 0.0;
        if (slope >= 0.0) return 2.0;  // leaving, or parallel
        if (gap <= precision) return t;
        t -= gap / slope;
        if (t > 1.0) return 2.0;
    }
    return t;
}

void ContactSolver::bind(const SceneLevel& level, const Kernels& kernels, const Tolerances& tolerances) {
    kernels_ = &kernels;
    tolerances_ = tolerances;
    mean_edge_mm_ = level.mean_edge_mm;
    cell_mm_ = level.cell_mm;
    candidates_.bind(level, kernels);
    face_ = {};
    paused_ = 0, pause_ = 1;
    sole_ = false;
    touched_ = false;
}

// Evaluates a block from where the tool is now. An older evaluation still bounds it: a plane
// that separated a triangle once separates it for good, so a block is renewed only where its old planes say too little.
void ContactSolver::renew(std::uint32_t i, TickCounters& counters) {
    candidates_.key(i) = path_ + candidates_.evaluate(i, candidates_.centre() + local_, stamp_);
    counters.tests += 8;
}

// The least clearance at local_ that the planes of the last evaluation grant.
double ContactSolver::granted_here(std::uint32_t i, const SolverBall& ball) {
    const double least{kernels_->granted(candidates_.evaluation(i), move_since(i, local_, ball).data())};
    candidates_.key(i) = std::max(candidates_.key(i), path_ + least);
    return least;
}

// The same by the bound of a block that was never evaluated: it was found from where the candidates were gathered.
double ContactSolver::bounded_here(std::uint32_t i) {
    const double least = candidates_.bound(i, local_);
    candidates_.key(i) = std::max(candidates_.key(i), path_ + least);
    return least;
}

bool ContactSolver::separated(const Triangle& t, double kept) const {
    for (int i = 0; i < planes_.count; ++i) {
        const ContactPlane& p = planes_.planes[i];
        const double highest = std::max({dot(p.normal, t.a), dot(p.normal, t.b), dot(p.normal, t.c)});
        if (highest + kept <= p.offset + tolerances_.covered) return true;
    }
    return false;
}

void ContactSolver::collect_touching(std::span<const SolverBall> balls, TickCounters& counters) {
    std::size_t count = 0;
    const double within = tolerances_.touching;
    counters.tests += candidates_.block_count() / 16;
    for (std::uint32_t i = 0; i < candidates_.block_count(); ++i) {
        if (candidates_.key(i) - path_ > within) continue;
        const SolverBall& ball = balls[candidates_.ball(i)];
        if (candidates_.stamp(i) != stamp_) {
            ++counters.tests;
            if (candidates_.evaluated(i)) {
                if (granted_here(i, ball) > within) continue;
            } else if (bounded_here(i) > within) {
                continue;
            }
            renew(i, counters);
        }
        const EvalBlock& e = candidates_.evaluation(i);
        for (std::uint32_t k = 0; k < 8; ++k) {
            if (double{e.clearance[k]} > within) continue;
            const ClosestPoint c = closest_on_triangle(local_, candidates_.triangle(i, k));
            const double d = std::sqrt(c.distance2);
            if (!(d > 0.0)) continue;  // exactly on it: no side to keep
            const Vec3 n = (local_ - c.point) * (1.0 / d);
            std::size_t at = count;
            if (count == kMaxTouches) {
                if (d - ball.kept >= touches_[kMaxTouches - 1].clearance) continue;
                at = kMaxTouches - 1;
            } else {
                ++count;
            }
            const Touch touch{d - ball.kept,
                              {n, dot(n, c.point) + ball.kept, c.point + ball.offset, ball.kept - ball.radius,
                               candidates_.triangle_id(i, k), candidates_.ball(i), i, static_cast<std::uint16_t>(k),
                               candidates_.part(i)}};
            for (; at > 0 && touches_[at - 1].clearance > touch.clearance; --at) touches_[at] = touches_[at - 1];
            touches_[at] = touch;
        }
    }
    touch_count_ = count;
    planes_.count = 0;
    for (std::size_t i = 0; i < count && planes_.count < kMaxPlanes; ++i) {
        const ContactPlane& plane = touches_[i].plane;
        if (!separated(candidates_.triangle(plane.block, plane.lane), balls[plane.ball].kept))
            planes_.planes[planes_.count++] = plane;
    }
}

std::span<const ContactSolver::Touch> ContactSolver::touches(std::span<const SolverBall> balls,
                                                             TickCounters& counters) {
    if (!candidates_.valid() || !candidates_hold(x_)) gather(wanted_reach(0.0), balls, counters);
    next_stamp();  // the last step was not followed by a look
    local_ = x_ - candidates_.centre();
    collect_touching(balls, counters);
    return {touches_.data(), touch_count_};
}

// Does every active plane still come from the inside of its face, seen from local_? Then it is the same plane.
bool ContactSolver::still_planes(const Contact& contact, std::span<const SolverBall> balls) {
    for (int i = 0; i < contact.active; ++i) {
        const ContactPlane& p = contact.planes[i];
        const Triangle t = triangle_of(p, balls[p.ball]);
        const Vec3 n = cross(t.b - t.a, t.c - t.a);
        const double along = dot(n, p.normal);
        if (along * along < (1.0 - 1e-12) * norm2(n) || !closest_on_triangle(local_, t).interior) return false;
    }
    return true;
}

double ContactSolver::sweep(const Vec3& step, std::span<const SolverBall> balls, TickCounters& counters) {
    const double length = norm(step), margin = tolerances_.skin;
    const Vec3 y = local_ + step;
    double first = 2.0;
    counters.tests += candidates_.block_count() / 16;
    for (std::uint32_t i = 0; i < candidates_.block_count(); ++i) {
        if (candidates_.key(i) - path_ > length) continue;
        const SolverBall& ball = balls[candidates_.ball(i)];
        if (candidates_.stamp(i) != stamp_) {
            ++counters.tests;
            if (candidates_.evaluated(i)) {
                const double here = granted_here(i, ball);
                if (here > length) continue;
                // One plane with both ends on its free side keeps the whole step free.
                if (here > margin && kernels_->granted(candidates_.evaluation(i), move_since(i, y, ball).data()) >
                                         static_cast<float>(margin))
                    continue;
            } else if (candidates_.passes_by(i, local_, step, margin)) {
                continue;
            }
            renew(i, counters);
            if (candidates_.key(i) - path_ > length) continue;
        }
        std::uint32_t bits =
            kernels_->crossed(candidates_.evaluation(i), move_since(i, y, ball).data(), static_cast<float>(margin));
        for (; bits != 0; bits &= bits - 1) {
            const auto k = static_cast<std::uint32_t>(std::countr_zero(bits));
            const Triangle t = candidates_.triangle(i, k);
            if (separated(t, ball.kept)) continue;
            const double reach = std::min(first, 1.0);
            const double at =
                time_of_touch(t, local_, step * reach, ball.kept - 0.1 * tolerances_.skin, 1e-3 * tolerances_.skin);
            if (at <= 1.0) first = at * reach;
        }
    }
    return first;
}

// Far enough for a tick or two at this speed: a longer reach gathers more than it saves.
double ContactSolver::wanted_reach(double motion_mm) const {
    return std::max(std::min(2.0 * motion_mm, 4.0 * cell_mm_) + kRoom * mean_edge_mm_, 16.0 * tolerances_.skin);
}

// Where x will be in these ticks lies ahead of it: half the reach, about a point ahead, holds as many ticks.
double ContactSolver::gather_ahead(const Vec3& motion, std::span<const SolverBall> balls, TickCounters& counters) {
    const double length = norm(motion);
    const double ticks = length > 0.0 ? std::min(kTicksAhead, 2.0 * cell_mm_ / length) : 0.0;
    return gather(std::max(1.1 * ticks * length + kRoom * mean_edge_mm_, 16.0 * tolerances_.skin), balls, counters,
                  motion * ticks);
}

double ContactSolver::gather(double reach, std::span<const SolverBall> balls, TickCounters& counters,
                             const Vec3& ahead) {
    const double path = path_;
    path_ = norm(ahead);
    return candidates_.gather(x_ + ahead, reach, path, path_, balls, counters);
}

// Lists what is near for a further way, twice as far each time. False: so much lies around that none is left to move.
bool ContactSolver::gather_further(double& wanted, std::span<const SolverBall> balls, TickCounters& counters) {
    const double granted = gather(wanted, balls, counters);
    if (granted < wanted) counters.errors |= kErrCandidates;
    // A long way to go needs longer steps, unless so much lies around that they cost more than they save.
    if (candidates_.block_count() < Candidates::kMaxBlocks / 16) wanted = std::min(2.0 * wanted, 64.0 * cell_mm_);
    return granted > 4.0 * tolerances_.skin;
}

// Along the step as far as nothing is met, whatever the reach of the candidates: where that ends, what lies further is
// gathered on the way. True: all of it.
bool ContactSolver::travel(Vec3 step, double& wanted, int& iteration, std::span<const SolverBall> balls,
                           TickCounters& counters) {
    if (const double length2 = norm2(step); length2 <= proven_ * proven_) {
        x_ += step;
        path_ += std::sqrt(length2);
        local_ += step;
        proven_ = 0.0;
        return true;
    }
    for (;;) {
        // Clip to the ball the candidates are complete for: |local + t step| = limit.
        const double limit = candidates_.reach() - 2.0 * tolerances_.skin;
        double whole = 1.0;
        if (norm2(local_ + step) > limit * limit) {
            const double a = norm2(step), b = dot(local_, step), c = norm2(local_) - limit * limit;
            whole = std::clamp((-b + std::sqrt(std::max(b * b - a * c, 0.0))) / a, 0.0, 1.0);
        }
        const Vec3 part = step * whole;
        const double t = std::min(sweep(part, balls, counters), 1.0);
        x_ += part * t;
        path_ += norm(part) * t;
        if (t < 1.0) return false;
        local_ += part;
        if (whole == 1.0) return true;
        if (counters.work() > work_limit_ || ++iteration == kMaxIterations) return false;
        ++counters.iterations;
        const Vec3 centre = candidates_.centre();
        if (!gather_further(wanted, balls, counters)) return false;
        next_stamp();
        local_ = x_ - candidates_.centre();
        const Vec3 shift = candidates_.centre() - centre;
        for (int i = 0; i < planes_.count; ++i) {
            planes_.planes[i].offset -= dot(planes_.planes[i].normal, shift);
            planes_.planes[i].point = planes_.planes[i].point - shift;
        }
        step = step - part;
    }
}

void ContactSolver::advance(const Vec3& hip, std::span<const SolverBall> balls, const Vec3& motion,
                            TickCounters& counters, Contact& out) {
    out.active = 0;
    out.between = false;
    for (bool& behind : out.behind) behind = false;
    if (balls.size() == 1 && glide(hip, balls[0], motion, counters, out)) return;
    out.converged = false;
    double wanted = wanted_reach(norm(motion));
    const double ahead_mm = norm(motion) * kAheadOfFace + kRoom * mean_edge_mm_;
    bool looked_around = false;
    Slide slide;
    Vec3 last = x_, before_last = x_;
    for (int k = 0; k < kMaxIterations; ++k) {
        // Out of time: what was reached is safe, and the next tick goes on from there.
        if (k > 0 && counters.work() > work_limit_) break;
        ++counters.iterations;
        next_stamp();
        const double settled =
            k <= kPatience ? tolerances_.settled : tolerances_.settled * std::min(std::exp2(k - kPatience), 100.0);
        local_ = x_ - candidates_.centre();
        if (!on_proven_face(balls, hip - candidates_.centre(), counters)) {
            // What one plane holds keeps a wider view: it is cheap there, and what is proven serves the next tick.
            const bool sole = sole_;
            if (!looked_around && (!candidates_.valid() || !candidates_hold(x_) ||
                                   (sole ? norm(x_ - candidates_.centre()) + ahead_mm > candidates_.reach()
                                         : !candidates_hold(x_ + motion * 1.1)))) {
                looked_around = true;
                out.active = 0;  // planes of the last step are in the old frame
                if (sole)
                    gather(norm(motion) + ahead_mm + 16.0 * tolerances_.skin, balls, counters, motion);
                else
                    gather_ahead(motion, balls, counters);
            }
            if (!candidates_hold(x_)) {
                out.active = 0;
                if (!gather_further(wanted, balls, counters)) {
                    counters.errors |= kErrNotConverged;
                    out.scp = x_;
                    out.active = 0;
                    return;
                }
            }
            local_ = x_ - candidates_.centre();
            if (!find_sole_plane(balls, hip - candidates_.centre(), ahead_mm, counters))
                collect_touching(balls, counters);
        }
        const Vec3 centre = candidates_.centre();
        // Two faces of a shallow crease can send the point to and fro: then both count at once.
        const int touched = planes_.count;
        if (k >= 2 && norm2(x_ - before_last) < 0.25 * norm2(x_ - last))
            for (int i = 0; i < out.active && planes_.count < kMaxPlanes; ++i)
                planes_.planes[planes_.count++] = out.planes[i];
        before_last = last;
        last = x_;
        PlaneSolution solution = nearest_feasible(planes_, hip - centre, false, 1e-3 * tolerances_.settled);
        Vec3 step = solution.y - local_;
        double length = norm(step);
        if (planes_.count > touched && length <= settled) {
            // Only what is touched may hold the tool at the end.
            planes_.count = touched;
            solution = nearest_feasible(planes_, hip - centre, false, 1e-3 * tolerances_.settled);
            step = solution.y - local_;
            length = norm(step);
        }
        if (!solution.feasible) {
            // Walls that leave no more room than rounding takes: no plane may ask for more than there is, and the next
            // aim is nearer, so that rounding is smaller.
            for (int i = 0; i < planes_.count; ++i) {
                ContactPlane& p = planes_.planes[i];
                p.offset = std::min(p.offset, dot(p.normal, local_));
            }
            const Vec3 to_hip = hip - centre - local_;
            const double near = std::min(1.0, candidates_.reach() / norm(to_hip));
            for (double tolerance = tolerances_.settled; !solution.feasible && tolerance < tolerances_.skin;
                 tolerance *= 4.0)
                solution = nearest_feasible(planes_, local_ + to_hip * near, false, tolerance);
            step = solution.y - local_;
            length = norm(step);
            if (!solution.feasible) break;
        }
        out.active = solution.active;
        for (int i = 0; i < solution.active; ++i) {
            out.planes[i] = planes_.planes[solution.index[i]];
            out.multiplier[i] = solution.multiplier[i];
        }
        if (length <= settled) {
            out.converged = true;
            break;
        }
        bool stretched = false;
        if (solution.active > 0) {
            // Stretched, then back behind no plane: the sweep spares what the planes separate.
            if (const double stretch = std::min(slide.stretch(step, length), kShortStep * mean_edge_mm_ / length);
                stretch > 1.0 && length < (k < kPatience ? 0.3 : 1.0) * kShortStep * mean_edge_mm_) {
                const PlaneSolution far =
                    nearest_feasible(planes_, local_ + step * stretch, false, 1e-3 * tolerances_.settled);
                if (far.feasible) step = far.y - local_, length = norm(step), stretched = true;
            }
        }
        const bool arrived = travel(step, wanted, k, balls, counters);
        if (norm2(candidates_.centre() - centre) > 0.0) out.active = 0;
        if (!arrived || (planes_.count > 0 && out.active == 0)) continue;
        // Arrived: at the HIP with nothing touched, or on faces whose planes are the same here. Nothing else was met on
        // the way, so there is nothing left to solve.
        if (planes_.count == 0 || (!stretched && still_planes(out, balls))) {
            out.converged = true;
            break;
        }
    }
    const Vec3 centre = candidates_.centre();
    if (!out.converged) {
        counters.errors |= kErrNotConverged;
        out.scp = x_;
        for (int i = 0; i < out.active; ++i) out.planes[i].point += centre;
        // On its way from one contact to the next: the force stays, along what is left of the way.
        if (const Vec3 left = x_ - hip; out.active == 0 && touched_ && norm(left) > tolerances_.settled) {
            out.active = 1;
            out.between = true;
            out.planes[0] = last_touch_;
            out.multiplier[0] = norm(left);
            out.planes[0].normal = left * (1.0 / out.multiplier[0]);
        }
        return;
    }
    // The same planes without the skin: what the surface itself allows.
    const PlaneSolution final = nearest_feasible(planes_, hip - centre, true, 1e-3 * tolerances_.settled);
    // Between steep planes the way back to the surface is long without being nearer to it: at a cube's corner it is
    // sqrt(3) times the slack, and no contact that the tool's radius resolves needs more.
    double slack_mm = 0.0;
    for (int i = 0; i < final.active; ++i) slack_mm = std::max(slack_mm, planes_.planes[final.index[i]].slack);
    const Vec3 back = final.y - local_;
    const double most = 1.75 * slack_mm + tolerances_.skin, way = norm(back);
    out.scp = centre + (final.active > 0 && way > most ? local_ + back * (most / way) : final.y);
    out.active = final.active;
    for (int i = 0; i < final.active; ++i) {
        out.planes[i] = planes_.planes[final.index[i]];
        // The plane may have been taken before the last slide along it.
        const Triangle t = triangle_of(out.planes[i], balls[out.planes[i].ball]);
        out.planes[i].point = closest_on_triangle(local_, t).point + balls[out.planes[i].ball].offset + centre;
        out.multiplier[i] = final.multiplier[i];
        out.behind[i] = dot(cross(t.b - t.a, t.c - t.a), out.planes[i].normal) < 0.0;
    }
    touched_ = final.active > 0;
    if (touched_) last_touch_ = out.planes[0];
}

}  // namespace hapticlod
