// Changing the level with the contact kept.
#include <algorithm>
#include <cmath>

#include "core/renderer_state.hpp"

namespace hapticlod {

MappingOutcome Renderer::State::change_level(std::uint32_t from, std::uint32_t to, const Vec3& last_hip,
                                             TickCounters& counters) {
    const bool paper = config.mapping == static_cast<std::uint32_t>(Mapping::paper);
    if (contact.active == 0) {
        // In free space, but outside this level may be inside the next: the tool must not start behind it.
        const double bound = paper ? 0.0 : config.closest_bound_mm;
        if (bound > 0.0 && scene.at(to).visible_count > 1) {
            const std::uint64_t behind = parts_behind(from, bound, counters);
            bool moved = false;
            get_out_of_parts(to, scene.visible() & ~behind, 0, bound, moved, counters);
        } else if (bound > 0.0) {
            const SurfaceSide before = surface_side(solver, tool(from), bound, counters);
            solver.bind(scene.at(to), best_kernels(), tolerances);
            bool moved = false;
            if (!before.found || before.distance >= 0.0) get_out(to, bound, moved, counters);
        } else {
            solver.bind(scene.at(to), best_kernels(), tolerances);
        }
        return MappingOutcome::none;
    }
    // Where parts meet, the place that is found may lie in front of one and inside another.
    const double bound_mm = config.closest_bound_mm;
    const bool among_parts = !paper && bound_mm > 0.0 && scene.at(to).visible_count > 1;
    const std::uint64_t behind = among_parts ? parts_behind(from, bound_mm, counters) : 0;
    solver.bind(scene.at(to), best_kernels(), tolerances);
    if (paper) return Mapper::paper(solver, memory, config.l_out_mm, counters);
    const MappingOutcome outcome =
        mapper.two_sided(solver, memory, config.l_in_mm, config.l_out_mm, config.closest_bound_mm, tool(to), counters);
    if (outcome == MappingOutcome::miss) {
        // Where it was it may well be free on this level: then it goes on from there.
        counters.errors |= kErrContactLost;
        const double longest = std::max({config.l_in_mm, config.l_out_mm, config.closest_bound_mm});
        bool moved = false;
        const double bound = solver.closed() ? extent_mm : 2.0 * longest;
        const bool out = scene.at(to).visible_count > 1
                             ? get_out_of_parts(to, scene.visible(), 0, bound, moved, counters)
                             : get_out(to, bound, moved, counters);
        if (!out) solver.place(last_hip);
        if (moved) gate.engage(config.engage_s);
    } else if (among_parts) {
        bool moved = false;
        get_out_of_parts(to, scene.visible() & ~behind, 0, bound_mm, moved, counters);
    }
    return outcome;
}

// Changes the level with the HIP where it was in the last tick: what the blend must hide is the change alone.
MappingOutcome Renderer::State::switch_level(std::uint32_t from, std::uint32_t to, const Vec3& last_hip,
                                             TickCounters& counters) {
    const bool touching = contact.active > 0;
    const Vec3 rendered = blend.rendered(contact.scp + shade, norm(contact.scp - last_hip));
    const MappingOutcome outcome = change_level(from, to, last_hip, counters);
    if (!touching) return outcome;
    contact.active = 0;  // friction holds nothing of the old level
    if (outcome != MappingOutcome::miss && config.blend_s > 0.0) {
        touch(to, last_hip, {}, counters);
        if (contact.active > 0) {
            blend.begin(rendered - contact.scp - shade, config.blend_s, norm(contact.scp - last_hip));
            switched = felt;
        }
    }
    return outcome;
}

}  // namespace hapticlod
