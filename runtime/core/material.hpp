// What the touched surface is made of: stiffness and friction between the vertices of a level, where the scan carries
// them. The definition: docs/materials.md. A level without materials takes no part in any of this.
#pragma once
#include <span>
#include <string>

#include "core/contact.hpp"
#include "core/level.hpp"

namespace hapticlod {

inline constexpr float kMaxMaterialStiffness = 1e6f;  // N/mm
inline constexpr float kMaxMaterialFriction = 10.0f;

// Empty: there are none, or one usable material per vertex. Otherwise the reason.
[[nodiscard]] std::string check_materials(std::span<const Material> materials, std::size_t vertices);

// What is felt at a contact.
struct FeltMaterial {
    double stiffness_n_mm = 0.0, friction_static = 0.0, friction_dynamic = 0.0;

    static FeltMaterial of_station(const ConfigData& c) {
        return {c.stiffness_n_mm, c.friction_static, c.friction_dynamic};
    }
    void add(const FeltMaterial& o, double weight) {
        stiffness_n_mm += weight * o.stiffness_n_mm;
        friction_static += weight * o.friction_static;
        friction_dynamic += weight * o.friction_dynamic;
    }
};

// One at share 0, the other at 1. Never beyond either, so the station's stiffness stays the bound.
inline FeltMaterial between(const FeltMaterial& from, const FeltMaterial& to, double share) {
    if (share == 0.0) return from;
    FeltMaterial felt;
    felt.add(from, 1.0 - share);
    felt.add(to, share);
    return felt;
}

// At a point of a face: between its corners by barycentric coordinates. A corner is never stiffer than the station. A
// level without materials is the station's.
[[nodiscard]] FeltMaterial material_at(const LevelView& level, const ConfigData& station, std::uint32_t face,
                                       const Vec3& point);

// Of a contact: the mean over its active planes by their multipliers, and over what touches at the same time without
// holding the tool (two balls on one plane) by its clearance, so that it changes nothing at once when the two change
// places.
[[nodiscard]] FeltMaterial contact_material(const ConfigData& station, const Contact& contact, ContactSolver& solver,
                                            std::span<const SolverBall> balls, TickCounters& counters);

}  // namespace hapticlod
