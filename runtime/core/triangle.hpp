// Closest point on a triangle in double precision: the exact step behind every decision of the contact solver.
// Interior by cross products (error grows with 1/sin of the corner, not its square: slivers stay usable), otherwise
// the nearest of the three edges, so degenerate triangles act as segments or points.
#pragma once
#include <algorithm>

#include "core/vec.hpp"

namespace hapticlod {

struct Triangle {
    Vec3 a, b, c;
};

struct ClosestPoint {
    Vec3 point;
    double distance2 = 0.0;
    bool interior = false;  // on the open face, not on an edge or a corner
};

inline Vec3 closest_on_segment(const Vec3& p, const Vec3& a, const Vec3& b) {
    const Vec3 ab = b - a;
    const double length2 = norm2(ab);
    const double t = length2 > 0.0 ? std::clamp(dot(p - a, ab) / length2, 0.0, 1.0) : 0.0;
    return a + ab * t;
}

inline ClosestPoint closest_on_triangle(const Vec3& p, const Triangle& t) {
    const Vec3 ab = t.b - t.a, ac = t.c - t.a, ap = p - t.a;
    const Vec3 n = cross(ab, ac);
    const double nn = norm2(n);
    if (nn > 0.0) {
        const double wc = dot(n, cross(ab, ap));
        const double wb = dot(n, cross(ap, ac));
        if (wb >= 0.0 && wc >= 0.0 && wb + wc <= nn) {
            const double height = dot(n, ap);
            return {p - n * (height / nn), height * height / nn, true};
        }
    }
    ClosestPoint best{closest_on_segment(p, t.a, t.b), 0.0, false};
    best.distance2 = norm2(p - best.point);
    const Vec3 on_bc = closest_on_segment(p, t.b, t.c);
    if (const double d2 = norm2(p - on_bc); d2 < best.distance2) best = {on_bc, d2, false};
    const Vec3 on_ca = closest_on_segment(p, t.c, t.a);
    if (const double d2 = norm2(p - on_ca); d2 < best.distance2) best = {on_ca, d2, false};
    return best;
}

}  // namespace hapticlod
