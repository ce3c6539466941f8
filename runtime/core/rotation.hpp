// Turning the tool in contact. A rotation carries every ball along a chord; where a chord would pass through the
// surface, the reference point gives way by the least translation that keeps all balls on their side.
#pragma once
#include <span>

#include "core/contact.hpp"

namespace hapticlod {

// balls are as before the turn, offsets after it. On success the solver's reference point has been moved; false: the
// turn cannot be resolved now and nothing was moved.
bool make_way_for_turn(ContactSolver& solver, std::span<const SolverBall> balls, std::span<const Vec3> offsets,
                       TickCounters& counters);

}  // namespace hapticlod
