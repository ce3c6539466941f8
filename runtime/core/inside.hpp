// Which side of the surface is the tool on, and the way out where it starts inside.
#pragma once
#include <span>

#include "core/contact.hpp"

namespace hapticlod {

struct ContactMemory;

struct SurfaceSide {
    bool found = false;     // a surface within the bound
    double distance = 0.0;  // from the ball's centre, negative behind the surface
    Vec3 point, normal;     // nearest surface point and its angle-weighted normal (Baerentzen & Aanaes 2005)
    std::uint32_t ball = 0;
};

// The ball that is deepest (or nearest), searched within bound_mm of the balls. front: -1 where the tool belongs behind
// the surface, 0 where one side is as good as the other.
[[nodiscard]] SurfaceSide surface_side(ContactSolver& solver, std::span<const SolverBall> balls, double bound_mm,
                                       TickCounters& counters, double front = 1.0);

// Puts the tool on the nearest surface: on its front, or on the side that memory says was touched. False, with the
// point unmoved, where none is within the bound or the tool would still overlap.
bool place_on_closest(ContactSolver& solver, std::span<const SolverBall> balls, double bound_mm,
                      const ContactMemory* memory, TickCounters& counters);

// Parameter in [0, 1] at which the segment p q meets the triangle; 2 where it does not.
[[nodiscard]] double segment_hit(const Vec3& p, const Vec3& q, const Triangle& t);

}  // namespace hapticlod
