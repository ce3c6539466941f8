#include "core/plane_qp.hpp"

namespace hapticlod {
namespace {

double bound(const ContactPlane& p, bool without_slack) { return without_slack ? p.offset - p.slack : p.offset; }

// Projection of the target onto the intersection of up to three planes. False where they are (nearly) dependent.
bool project(const PlaneSet& set, const Vec3& h, bool without_slack, PlaneSolution& s) {
    double g[3][3], rhs[3];
    for (int i = 0; i < s.active; ++i) {
        const ContactPlane& p = set.planes[s.index[i]];
        rhs[i] = bound(p, without_slack) - dot(p.normal, h);
        for (int j = 0; j < s.active; ++j) g[i][j] = dot(p.normal, set.planes[s.index[j]].normal);
    }
    constexpr double kDependent = 1e-14;  // sin^2 of the least angle between planes that are told apart
    if (s.active == 1) {
        s.multiplier[0] = rhs[0];
    } else if (s.active == 2) {
        const double det = norm2(cross(set.planes[s.index[0]].normal, set.planes[s.index[1]].normal));
        if (det < kDependent) return false;
        s.multiplier[0] = (rhs[0] - g[0][1] * rhs[1]) / det;
        s.multiplier[1] = (rhs[1] - g[0][1] * rhs[0]) / det;
    } else {
        const Vec3 n0 = set.planes[s.index[0]].normal, n1 = set.planes[s.index[1]].normal,
                   n2 = set.planes[s.index[2]].normal;
        const double volume = dot(n0, cross(n1, n2));
        if (volume * volume < kDependent) return false;
        // The displacement d solves n_i.d = rhs_i; its components along the reciprocal basis are the multipliers.
        const Vec3 d = (cross(n1, n2) * rhs[0] + cross(n2, n0) * rhs[1] + cross(n0, n1) * rhs[2]) * (1.0 / volume);
        s.multiplier[0] = dot(cross(n1, n2), d) / volume;
        s.multiplier[1] = dot(cross(n2, n0), d) / volume;
        s.multiplier[2] = dot(cross(n0, n1), d) / volume;
    }
    s.y = h;
    for (int i = 0; i < s.active; ++i) s.y += set.planes[s.index[i]].normal * s.multiplier[i];
    return true;
}

}  // namespace

PlaneSolution nearest_feasible(const PlaneSet& set, const Vec3& target, bool without_slack, double tolerance) {
    PlaneSolution best;
    best.y = target;
    if (set.count == 1) {  // the common case, with the same arithmetic as the general one
        const ContactPlane& p = set.planes[0];
        const double violation = bound(p, without_slack) - dot(p.normal, target);
        if (violation > tolerance) {
            best.active = 1;
            best.multiplier[0] = violation;
            best.y += p.normal * violation;
        }
        return best;
    }
    for (int round = 0; round < 4 * kMaxPlanes; ++round) {
        int worst = -1;
        double violation = tolerance;
        for (int i = 0; i < set.count; ++i) {
            const double v = bound(set.planes[i], without_slack) - dot(set.planes[i].normal, best.y);
            if (v > violation) violation = v, worst = i;
        }
        if (worst < 0) return best;
        // Subsets of the old basis, each with the violated plane added; the valid one with the least distance wins.
        PlaneSolution next;
        bool found = false;
        double least = 0.0;
        for (unsigned keep = 0; keep < (1u << best.active); ++keep) {
            PlaneSolution s;
            s.index[s.active++] = worst;
            bool fits = true;
            for (int k = 0; k < best.active && fits; ++k)
                if (keep >> k & 1u) {
                    if (s.active == 3)
                        fits = false;
                    else
                        s.index[s.active++] = best.index[k];
                }
            if (!fits || !project(set, target, without_slack, s)) continue;
            bool valid = true;
            for (int k = 0; k < s.active; ++k) valid = valid && s.multiplier[k] >= 0.0;
            for (int k = 0; k < best.active && valid; ++k) {
                const ContactPlane& p = set.planes[best.index[k]];
                valid = bound(p, without_slack) - dot(p.normal, s.y) <= tolerance;
            }
            const double d2 = norm2(s.y - target);
            if (valid && (!found || d2 < least)) next = s, least = d2, found = true;
        }
        if (!found) break;  // planes contradict each other within rounding
        best = next;
    }
    best.feasible = false;
    return best;
}

}  // namespace hapticlod
