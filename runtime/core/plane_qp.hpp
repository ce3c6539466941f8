// The point nearest to a target that keeps to the free side of a few planes: min |y - h|^2 with n_i.y >= b_i.
// Strictly convex in three dimensions, so at most three planes are active; the active set grows by the most violated
// plane and is re-solved over the subsets that contain it (an LP-type basis exchange, Matousek, Sharir & Welzl 1996).
#pragma once
#include <array>
#include <cstdint>

#include "core/vec.hpp"

namespace hapticlod {

struct ContactPlane {
    Vec3 normal;          // unit, away from the surface
    double offset = 0.0;  // n.y >= offset for the tool's reference point
    Vec3 point;           // contact point on the surface
    double slack = 0.0;   // kept distance beyond the ball's radius: skin and crack bridging
    std::uint32_t triangle = 0;
    std::uint32_t ball = 0;
    std::uint32_t block = 0;           // the candidate it belongs to
    std::uint16_t lane = 0, part = 0;  // and whose triangle it is
};

inline constexpr int kMaxPlanes = 24;

struct PlaneSet {
    std::array<ContactPlane, kMaxPlanes> planes;
    int count = 0;
};

struct PlaneSolution {
    Vec3 y;
    int active = 0;                      // 0..3
    std::array<int, 3> index{};          // active planes
    std::array<double, 3> multiplier{};  // y = h + sum multiplier_k normal_k, all >= 0
    bool feasible = true;
};

// without_slack: planes at offset - slack, where the surface itself is. tolerance: violation that is accepted.
[[nodiscard]] PlaneSolution nearest_feasible(const PlaneSet& set, const Vec3& target, bool without_slack,
                                             double tolerance);

}  // namespace hapticlod
