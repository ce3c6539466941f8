#include "core/material.hpp"

#include <algorithm>

#include "core/surface.hpp"

namespace hapticlod {
namespace {

FeltMaterial at_vertex(const Material& m, const ConfigData& station) {
    FeltMaterial felt = FeltMaterial::of_station(station);
    if (m.stiffness_n_mm >= 0.0f) felt.stiffness_n_mm = std::min(felt.stiffness_n_mm, double{m.stiffness_n_mm});
    if (m.friction_static >= 0.0f) felt.friction_static = double{m.friction_static};
    if (m.friction_dynamic >= 0.0f) felt.friction_dynamic = double{m.friction_dynamic};
    return felt;
}

}  // namespace

std::string check_materials(std::span<const Material> materials, std::size_t vertices) {
    if (materials.empty()) return {};
    if (materials.size() != vertices) return "materials and vertices differ in number";
    for (const Material& m : materials) {
        const bool stiff = m.stiffness_n_mm > 0.0f && m.stiffness_n_mm <= kMaxMaterialStiffness;
        if (!stiff && m.stiffness_n_mm != kAsStation) return "a material's stiffness is out of range";
        const bool as_station = m.friction_static == kAsStation && m.friction_dynamic == kAsStation;
        if (as_station) continue;
        if (!(m.friction_static >= 0.0f && m.friction_static <= kMaxMaterialFriction))
            return "a material's static friction is out of range";
        if (!(m.friction_dynamic >= 0.0f && m.friction_dynamic <= m.friction_static))
            return "a material's dynamic friction is negative or exceeds its static friction";
    }
    return {};
}

FeltMaterial material_at(const LevelView& level, const ConfigData& station, std::uint32_t face, const Vec3& point) {
    if (level.materials.empty()) return FeltMaterial::of_station(station);
    const Triangle t = level_triangle(level, face);
    const Vec3 n = cross(t.b - t.a, t.c - t.a);
    const double nn = norm2(n);
    double w[3] = {1.0, 1.0, 1.0}, sum = 3.0;
    if (nn > 0.0) {
        sum = 0.0;
        const std::array<double, 3> on = weights_on(t, n, nn, point);
        for (std::size_t k = 0; k < 3; ++k) sum += w[k] = std::max(on[k], 0.0);  // rounding, on an edge
    }
    FeltMaterial felt;
    for (std::size_t k = 0; k < 3; ++k)
        felt.add(at_vertex(level.materials[level.faces[3 * std::size_t{face} + k]], station), w[k] / sum);
    return felt;
}

FeltMaterial contact_material(const ConfigData& station, const Contact& contact, ContactSolver& solver,
                              std::span<const SolverBall> balls, TickCounters& counters) {
    const SceneLevel& level = solver.candidates().level();
    const auto view = [&level](std::uint32_t part) -> const LevelView& { return level.surfaces[part]->view; };
    if (std::all_of(level.visible.begin(), level.visible.begin() + level.visible_count,
                    [&](std::uint32_t part) { return view(part).materials.empty(); }))
        return FeltMaterial::of_station(station);
    FeltMaterial sum;
    double total = 0.0;
    const auto add = [&](const ContactPlane& p, const Vec3& point, double weight) {
        if (!(weight > 0.0)) return;
        sum.add(material_at(view(p.part), station, p.triangle, point), weight);
        total += weight;
    };
    for (int i = 0; i < contact.active; ++i) add(contact.planes[i], contact.planes[i].point, contact.multiplier[i]);
    if (balls.size() > 1 && contact.converged) {  // cut short, the solver has moved on from where it last looked
        const Vec3 centre = solver.candidates().centre();
        const std::span<const ContactSolver::Touch> touches = solver.touches(balls, counters);
        for (std::size_t k = 0; k < touches.size(); ++k) {
            const ContactPlane& p = touches[k].plane;
            const double near = std::clamp(1.0 - touches[k].clearance / solver.tolerances().touching, 0.0, 1.0);
            double held = 0.0, own = 1.0;
            for (int i = 0; i < contact.active; ++i) {
                const double along = std::max(dot(p.normal, contact.planes[i].normal), 0.0);
                held += contact.multiplier[i] * along;
                if (contact.planes[i].ball == p.ball) own = std::min(own, 1.0 - along);
            }
            // One ball has one place in one direction, however many faces meet there: the nearest, which came first.
            for (std::size_t j = 0; j < k && own > 0.0; ++j)
                if (touches[j].plane.ball == p.ball) own = std::min(own, 1.0 - dot(p.normal, touches[j].plane.normal));
            add(p, p.point + centre, near * held * own);
        }
    }
    // At no depth at all nothing has a weight, and there is no force yet.
    const ContactPlane& first = contact.planes[0];
    if (!(total > 0.0)) return material_at(view(first.part), station, first.triangle, first.point);
    FeltMaterial mean;
    mean.add(sum, 1.0 / total);
    return mean;
}

}  // namespace hapticlod
