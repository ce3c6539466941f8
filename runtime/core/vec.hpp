// Three-vectors in double precision. Physics is double; only stored meshes and culling kernels are float.
#pragma once
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

// Rotation by a unit quaternion (w x y z).
inline Vec3 rotate(const double q[4], const Vec3& v) {
    const Vec3 u{q[1], q[2], q[3]};
    const Vec3 t = 2.0 * cross(u, v);
    return v + q[0] * t + cross(u, t);
}

}  // namespace hapticlod
