// Normals of a level's surface: of a face, and interpolated over it from its vertices (force shading, Morgenbesser &
// Srinivasan 1996).
#pragma once
#include <array>

#include "core/level.hpp"
#include "core/triangle.hpp"

namespace hapticlod {

inline Vec3 level_vertex(const LevelView& level, std::uint32_t i) {
    const float* v = &level.vertices[3 * std::size_t{i}];
    return {v[0], v[1], v[2]};
}

inline Triangle level_triangle(const LevelView& level, std::uint32_t f) {
    const std::uint32_t* i = &level.faces[3 * std::size_t{f}];
    return {level_vertex(level, i[0]), level_vertex(level, i[1]), level_vertex(level, i[2])};
}

// Not normalised: twice the area along the normal.
inline Vec3 face_normal(const LevelView& level, std::uint32_t f) {
    const Triangle t = level_triangle(level, f);
    return cross(t.b - t.a, t.c - t.a);
}

// Barycentric weights of a point of the triangle's plane; n is its normal, not normalised, nn > 0 that one's square.
inline std::array<double, 3> weights_on(const Triangle& t, const Vec3& n, double nn, const Vec3& at) {
    const double wc = dot(n, cross(t.b - t.a, at - t.a)) / nn, wb = dot(n, cross(at - t.a, t.c - t.a)) / nn;
    return {1.0 - wb - wc, wb, wc};
}

// Unit, on the side of `towards`; `towards` itself where the level has no normal there.
inline Vec3 shaded_normal(const LevelView& level, std::uint32_t f, const Vec3& at, const Vec3& towards) {
    const Triangle t = level_triangle(level, f);
    const Vec3 n = cross(t.b - t.a, t.c - t.a);
    const double nn = norm2(n);
    if (!(nn > 0.0)) return towards;
    const std::array<double, 3> w = weights_on(t, n, nn, at);
    Vec3 sum;
    for (std::size_t k = 0; k < 3; ++k) {
        const float* v = &level.normals[3 * std::size_t{level.faces[3 * std::size_t{f} + k]}];
        sum += Vec3{v[0], v[1], v[2]} * w[k];
    }
    const double length = norm(sum);
    if (!(length > 0.0)) return towards;
    const double sign = dot(n, towards) < 0.0 ? -1.0 : 1.0;
    return sum * (sign / length);
}

}  // namespace hapticlod
