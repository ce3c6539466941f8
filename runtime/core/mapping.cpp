#include "core/mapping.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "core/inside.hpp"

namespace hapticlod {
namespace {

// An interval asks for two closest points and up to two times of touch: so many of the kernels' tests.
constexpr std::uint32_t kIntervalTests = 8;

// The stretch of the line p + t n, |t| <= c, on which the tool is too near to the triangle. Empty: from > to.
Interval blocked(const Triangle& t, const Vec3& p, const Vec3& n, double c, double kept, double precision,
                 double side) {
    const Vec3 face = cross(t.b - t.a, t.c - t.a);
    const double length = norm(face);
    const Vec3 lo = p - n * c, hi = p + n * c, up = n * (2.0 * c);
    const bool blocked_lo = closest_on_triangle(lo, t).distance2 < kept * kept;
    const bool blocked_hi = closest_on_triangle(hi, t).distance2 < kept * kept;
    const double enter = blocked_lo ? 0.0 : time_of_touch(t, lo, up, kept, precision);
    if (enter > 1.0) return {1.0, -1.0, false};
    const double leave = blocked_hi ? 0.0 : time_of_touch(t, hi, -up, kept, precision);
    if (leave > 1.0) return {1.0, -1.0, false};
    const double top = blocked_hi ? 2.0 * c : c - 2.0 * c * leave;
    // Resting against a face from its other side would mean having passed through it. On an edge the side of the face
    // that the ball is on counts: a steep face next to it may lean over the way out.
    const Vec3 at = p + n * top;
    const bool facing = !(length > 0.0) || side * dot(face, n) > -0.1 * length ||
                        side * dot(face, at - closest_on_triangle(at, t).point) > 0.0;
    return {-c + 2.0 * c * enter, top, facing};
}

}  // namespace

// Whether all balls can be on their side somewhere on the line, and where nearest to the present position.
bool Mapper::rest_on_line(ContactSolver& solver, const ContactMemory& memory, double l_in_mm, double l_out_mm,
                          bool sided, std::span<const SolverBall> balls, TickCounters& counters) {
    Candidates& candidates = solver.candidates();
    const Vec3 x = solver.position(), n = memory.normal;
    const double longest = std::max(l_in_mm, l_out_mm), precision = 0.02 * solver.tolerances().skin;
    // Behind the surface there is nothing to see of a ball: where sides count, the whole line has to be looked at.
    double c = sided ? longest : std::min(std::max(0.25 * solver.cell_mm(), 64.0 * solver.tolerances().skin), longest);
    while (longest > 0.0) {
        const double granted = solver.gather(c, balls, counters);
        if (granted < c) {
            counters.errors |= kErrCandidates;
            if (granted <= 0.0) break;
        }
        const double within = std::min(c, granted);
        const Vec3 lo = n * -within, hi = n * within;
        std::size_t count = 0, crossed = 0;
        counters.tests += candidates.block_count() / 16;  // bounds that are looked at, as in contact.cpp
        solver.begin_looking();
        for (std::uint32_t i = 0; i < candidates.block_count(); ++i) {
            if (candidates.passes_by(i, lo, hi - lo, 0.0)) continue;
            solver.look(i, counters);
            for (std::uint32_t bits = solver.may_touch(i, hi, solver.tolerances().skin); bits != 0; bits &= bits - 1) {
                const auto k = static_cast<std::uint32_t>(std::countr_zero(bits));
                counters.tests += kIntervalTests;
                const Triangle t = candidates.triangle(i, k);
                const Interval v = blocked(t, {}, n, within, balls[candidates.ball(i)].kept, precision, memory.side);
                if (v.from > v.to) continue;
                intervals_[count++] = v;
                if (const double at = sided ? segment_hit(lo, hi, t) : 2.0; at <= 1.0 && crossed < kMaxCrossings) {
                    const bool facing = memory.side * dot(cross(t.b - t.a, t.c - t.a), n) > 0.0;
                    crossings_[crossed++] = {within * (2.0 * at - 1.0), candidates.ball(i), facing};
                }
            }
        }
        // A ball's centre below a face that its line crosses is behind the surface, down to the crossing before; above
        // one that faces the other way, up to the crossing after.
        for (std::size_t i = 0; i < crossed; ++i) {
            const Crossing& here = crossings_[i];
            double before = -within, after = 2.0 * within;  // as good as for ever
            for (std::size_t k = 0; k < crossed; ++k) {
                if (crossings_[k].ball != here.ball) continue;
                if (crossings_[k].at < here.at) before = std::max(before, crossings_[k].at);
                if (crossings_[k].at > here.at) after = std::min(after, crossings_[k].at);
            }
            if (count == intervals_.size()) break;
            intervals_[count++] = here.facing ? Interval{before, here.at, true} : Interval{here.at, after, false};
        }
        // Tops of the union of blocked stretches: there the tool rests.
        std::sort(intervals_.begin(), intervals_.begin() + static_cast<std::ptrdiff_t>(count),
                  [](const Interval& a, const Interval& b) { return a.from < b.from; });
        double best = 0.0;
        bool found = false;
        for (std::size_t i = 0; i < count;) {
            double top = intervals_[i].to;
            bool facing = intervals_[i].facing;
            for (++i; i < count && intervals_[i].from <= top; ++i)
                if (intervals_[i].to > top) top = intervals_[i].to, facing = intervals_[i].facing;
            if (!facing || top < -l_in_mm || top > l_out_mm || std::abs(top) > within) continue;
            if (!found || std::abs(top) < std::abs(best)) best = top, found = true;
        }
        if (found) {
            solver.place(x + n * best);
            return true;
        }
        if (granted < c || c >= longest) break;
        c = std::min(2.0 * c, longest);
    }
    return false;
}

MappingOutcome Mapper::two_sided(ContactSolver& solver, const ContactMemory& memory, double l_in_mm, double l_out_mm,
                                 double bound_mm, std::span<const SolverBall> balls, TickCounters& counters) {
    const std::uint32_t cells = counters.cells;
    const bool several = balls.size() > 1;
    MappingOutcome outcome = MappingOutcome::miss;
    const Vec3 before = solver.position();
    const auto all_in_front = [&] {
        // A line that runs inside the surface all the way crosses nothing.
        const SurfaceSide deepest = surface_side(solver, balls, std::max(l_in_mm, l_out_mm), counters, memory.side);
        if (!deepest.found || memory.side * deepest.distance > 0.0) return true;
        solver.place(before);
        return false;
    };
    const auto rests = [&](bool sided) {
        return rest_on_line(solver, memory, l_in_mm, l_out_mm, sided, balls, counters) &&
               (!several || (sided && !solver.closed()) || all_in_front());
    };
    // Where the nearest rest leaves no ball behind, the whole line need not be looked at.
    if (rests(false) || (several && rests(true)))
        outcome = MappingOutcome::hit;
    else if (bound_mm > 0.0 && place_on_closest(solver, balls, bound_mm, &memory, counters))
        outcome = MappingOutcome::closest;
    else if (several && !solver.closed() && rest_on_line(solver, memory, l_in_mm, l_out_mm, false, balls, counters))
        outcome = MappingOutcome::hit;  // around an open border some ball may well be on another side
    solver.candidates().invalidate();
    counters.mapping_cells += counters.cells - cells;
    return outcome;
}

namespace {

// The nearest intersection of p q with what one surface holds in the box of the two corner voxels.
double first_hit_in_corner_box(const LevelView& level, const Vec3& p, const Vec3& q, TickCounters& counters) {
    const double h = level.hash->cell_mm;
    const double from[3] = {p.x, p.y, p.z}, to[3] = {q.x, q.y, q.z}, loose = double{level.hash->loose_mm};
    std::int32_t lo[3], hi[3];
    for (int k = 0; k < 3; ++k) {
        const std::int32_t first = 4 * level.hash->brick_min[k], last = 4 * level.hash->brick_max[k] + 3;
        lo[k] = static_cast<std::int32_t>(
            std::clamp(std::floor((std::min(from[k], to[k]) - loose) / h), first - 1.0, last + 1.0));
        hi[k] = static_cast<std::int32_t>(
            std::clamp(std::floor((std::max(from[k], to[k]) + loose) / h), first - 1.0, last + 1.0));
    }
    double nearest = 2.0;
    for (std::int32_t z = lo[2]; z <= hi[2]; ++z)
        for (std::int32_t y = lo[1]; y <= hi[1]; ++y)
            for (std::int32_t x = lo[0]; x <= hi[0]; ++x) {
                ++counters.cells;
                ++counters.mapping_cells;
                const Brick* brick = find_brick(level, x >> 2, y >> 2, z >> 2);
                const int bit = (x & 3) + 4 * (y & 3) + 16 * (z & 3);
                if (brick == nullptr || (brick->mask >> bit & 1u) == 0) continue;
                const std::uint32_t cell = cell_of(*brick, bit);
                for (std::uint32_t b = level.cells[cell]; b < level.cells[cell + 1]; ++b) {
                    counters.triangles += 8;
                    for (std::uint32_t k = 0; k < 8; ++k) {
                        const auto& v = level.blocks[b].v;
                        const Triangle t{
                            {v[0][k], v[1][k], v[2][k]}, {v[3][k], v[4][k], v[5][k]}, {v[6][k], v[7][k], v[8][k]}};
                        nearest = std::min(nearest, segment_hit(p, q, t));
                    }
                }
            }
    return nearest;
}

}  // namespace

MappingOutcome Mapper::paper(ContactSolver& solver, const ContactMemory& memory, double length_mm,
                             TickCounters& counters) {
    const Vec3 p = memory.point, q = p + memory.normal * length_mm;
    const SceneLevel& level = solver.candidates().level();
    double nearest = 2.0;
    for (std::uint32_t v = 0; v < level.visible_count; ++v)
        nearest = std::min(nearest, first_hit_in_corner_box(level.surfaces[level.visible[v]]->view, p, q, counters));
    solver.candidates().invalidate();
    if (nearest > 1.0) return MappingOutcome::miss;
    solver.place(solver.position() + memory.normal * (length_mm * nearest));
    return MappingOutcome::hit;
}

}  // namespace hapticlod
