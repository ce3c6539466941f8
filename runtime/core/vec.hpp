// Three-vectors in double precision. Physics is double; only stored meshes and culling kernels are float.
#pragma once
#include <algorithm>
#include <cmath>

namespace hapticlod {

struct Vec3 {
    double x = 0.0, y = 0.0, z = 0.0;

    constexpr Vec3 operator+(const Vec3& o) const { return {x + o.x, y + o.y, z + o.z}; }
    constexpr Vec3 operator-(const Vec3& o) const { return {x - o.x, y - o.y, z - o.z}; }
    constexpr Vec3 operator-() const { return {-x, -y, -z}; }
    constexpr Vec3 operator*(double s) const { return {x * s, y * s, z * s}; }
    constexpr Vec3& operator+=(const Vec3& o) { return *this = *this + o; }
    constexpr Vec3& operator-=(const Vec3& o) { return *this = *this - o; }
    [[nodiscard]] bool finite() const { return std::isfinite(x) && std::isfinite(y) && std::isfinite(z); }
    void store(double* out) const { out[0] = x, out[1] = y, out[2] = z; }
};

inline Vec3 load3(const double* p) { return {p[0], p[1], p[2]}; }
constexpr Vec3 operator*(double s, const Vec3& v) { return v * s; }
constexpr double dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
constexpr Vec3 cross(const Vec3& a, const Vec3& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
constexpr double norm2(const Vec3& a) { return dot(a, a); }
inline double norm(const Vec3& a) { return std::sqrt(norm2(a)); }

// The matrix of a unit quaternion (w x y z): cheaper than the quaternion where many vectors turn alike.
struct Rotation {
    Vec3 x, y, z;  // rows

    explicit Rotation(const double q[4])
        : x{1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]), 2.0 * (q[1] * q[2] - q[0] * q[3]),
            2.0 * (q[1] * q[3] + q[0] * q[2])},
          y{2.0 * (q[1] * q[2] + q[0] * q[3]), 1.0 - 2.0 * (q[1] * q[1] + q[3] * q[3]),
            2.0 * (q[2] * q[3] - q[0] * q[1])},
          z{2.0 * (q[1] * q[3] - q[0] * q[2]), 2.0 * (q[2] * q[3] + q[0] * q[1]),
            1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])} {}
    Vec3 operator*(const Vec3& v) const { return {dot(x, v), dot(y, v), dot(z, v)}; }
};

// A part of the shorter way from one unit quaternion to another.
inline void part_of_turn(const double from[4], const double to[4], double part, double out[4]) {
    double cosine = 0.0;
    for (int k = 0; k < 4; ++k) cosine += from[k] * to[k];
    const double sign = cosine < 0.0 ? -1.0 : 1.0, angle = std::acos(std::min(sign * cosine, 1.0));
    const double sine = std::sin(angle);
    const double a = sine > 1e-9 ? std::sin((1.0 - part) * angle) / sine : 1.0 - part;
    const double b = sign * (sine > 1e-9 ? std::sin(part * angle) / sine : part);
    double length2 = 0.0;
    for (int k = 0; k < 4; ++k) out[k] = a * from[k] + b * to[k], length2 += out[k] * out[k];
    for (int k = 0; k < 4; ++k) out[k] /= std::sqrt(length2);
}

}  // namespace hapticlod
