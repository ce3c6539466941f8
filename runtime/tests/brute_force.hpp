// Distances, sides and crossings of a mesh by trying every triangle, in double, sharing no code with the core: what the
// soak test and the Embree test hold the runtime against.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <span>
#include <vector>

namespace hapticlod::test {

using Point = std::array<double, 3>;

inline Point operator+(const Point& a, const Point& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Point operator-(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Point operator*(const Point& a, double s) { return {a[0] * s, a[1] * s, a[2] * s}; }
inline double inner(const Point& a, const Point& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline double length(const Point& a) { return std::sqrt(inner(a, a)); }
inline Point outer(const Point& a, const Point& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

// v turned by the unit quaternion w x y z, by its rotation matrix.
inline Point turned(const double q[4], const Point& v) {
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const Point rows[3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                           {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                           {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
    return {inner(rows[0], v), inner(rows[1], v), inner(rows[2], v)};
}

// Corners a, b, c of every triangle, as the level stores them: relative to the origin.
struct Corners {
    Point a, b, c;
};

inline std::vector<Corners> corners_of(std::span<const float> vertices, std::span<const std::uint32_t> faces) {
    const auto at = [&](std::uint32_t i) -> Point {
        const float* v = &vertices[3 * std::size_t{i}];
        return {double{v[0]}, double{v[1]}, double{v[2]}};
    };
    std::vector<Corners> out;
    for (std::size_t f = 0; f < faces.size(); f += 3) out.push_back({at(faces[f]), at(faces[f + 1]), at(faces[f + 2])});
    return out;
}

// Region by region (Ericson, Real-Time Collision Detection, 2005, section 5.1.5).
inline Point closest_on(const Point& p, const Corners& t) {
    const Point ab = t.b - t.a, ac = t.c - t.a;
    const Point ap = p - t.a, bp = p - t.b, cp = p - t.c;
    const double d1 = inner(ab, ap), d2 = inner(ac, ap), d3 = inner(ab, bp), d4 = inner(ac, bp), d5 = inner(ab, cp),
                 d6 = inner(ac, cp);
    if (d1 <= 0.0 && d2 <= 0.0) return t.a;
    if (d3 >= 0.0 && d4 <= d3) return t.b;
    const double vc = d1 * d4 - d3 * d2;
    if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) return t.a + ab * (d1 / (d1 - d3));
    if (d6 >= 0.0 && d5 <= d6) return t.c;
    const double vb = d5 * d2 - d1 * d6;
    if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) return t.a + ac * (d2 / (d2 - d6));
    const double va = d3 * d6 - d5 * d4;
    if (va <= 0.0 && d4 >= d3 && d5 >= d6) return t.b + (t.c - t.b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    const double scale = 1.0 / (va + vb + vc);
    return t.a + ab * (vb * scale) + ac * (vc * scale);
}

inline double distance_to(const Point& p, std::span<const Corners> mesh) {
    double least = std::numeric_limits<double>::max();
    for (const Corners& t : mesh) {
        const Point away = p - closest_on(p, t);
        least = std::min(least, inner(away, away));
    }
    return std::sqrt(least);
}

// 1 inside, 0 outside a closed mesh that faces outward; a sum of solid angles (van Oosterom & Strackee 1983).
inline double winding_number(const Point& p, std::span<const Corners> mesh) {
    double sum = 0.0;
    for (const Corners& t : mesh) {
        const Point a = t.a - p, b = t.b - p, c = t.c - p;
        const double la = length(a), lb = length(b), lc = length(c);
        sum += std::atan2(inner(a, outer(b, c)), la * lb * lc + inner(a, b) * lc + inner(b, c) * la + inner(c, a) * lb);
    }
    return sum / (2.0 * std::numbers::pi);
}

// How many triangles the segment p q crosses.
inline int crossings(const Point& p, const Point& q, std::span<const Corners> mesh) {
    int count = 0;
    for (const Corners& t : mesh) {
        const Point n = outer(t.b - t.a, t.c - t.a);
        const double hp = inner(n, p - t.a), hq = inner(n, q - t.a);
        if ((hp < 0.0) == (hq < 0.0)) continue;
        const Point d = q - p;
        const auto beside = [&](const Point& u, const Point& v) { return inner(d, outer(u - p, v - p)) >= 0.0; };
        const bool s0 = beside(t.a, t.b), s1 = beside(t.b, t.c), s2 = beside(t.c, t.a);
        count += s0 == s1 && s1 == s2;
    }
    return count;
}

}  // namespace hapticlod::test
