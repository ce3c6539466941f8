// Where a tick finds the tool in a place that the surface does not allow: at the start, after a change of levels, or of
// the scene.
#include <algorithm>
#include <bit>
#include <cmath>

#include "core/renderer_state.hpp"

namespace hapticlod {

// Where the tool overlaps the surface or is inside it: out, to the nearest place in front of it. False: it overlaps
// still. `moved` says whether it had to.
bool Renderer::State::get_out(std::uint32_t level, double bound_mm, bool& moved, TickCounters& counters) {
    const auto used = tool(level);
    const SurfaceSide side = surface_side(solver, used, bound_mm, counters);
    moved = side.found && side.distance < used[side.ball].kept;
    if (!moved || place_on_closest(solver, used, 2.0 * bound_mm, nullptr, counters)) return true;
    // Its balls want out on different sides, of a thin plate perhaps: any straight way out will do, a short one first.
    return leave_along_a_line(side.normal, solver.closed() ? extent_mm : bound_mm, used, counters);
}

bool Renderer::State::leave_along_a_line(const Vec3& n, double longest, std::span<const SolverBall> used,
                                         TickCounters& counters) {
    double size = 0.0;
    for (const SolverBall& ball : used) size = std::max(size, norm(ball.offset) + ball.kept);
    for (double way_mm = std::min(2.0 * size, longest);; way_mm = std::min(2.0 * way_mm, longest)) {
        for (const Vec3& way :
             {n, -n, Vec3{0, 0, 1}, Vec3{0, 0, -1}, Vec3{0, 1, 0}, Vec3{0, -1, 0}, Vec3{1, 0, 0}, Vec3{-1, 0, 0}}) {
            ContactMemory out;
            out.normal = way;
            if (mapper.rest_on_line(solver, out, 0.0, way_mm, true, used, counters)) return true;
        }
        if (way_mm >= longest) return false;
    }
}

// Which side of one part the tool is on, as if there were no other; nothing found where its box is out of reach. A
// bound of 0: any depth inside a closed part, a twentieth of an open one's size, for behind it is a place to be.
SurfaceSide Renderer::State::side_of_part(std::uint32_t level, std::uint32_t part, double bound_mm,
                                          TickCounters& counters) {
    const SceneLevel& alone = scene.alone(level, part);
    const Box& box = alone.boxes[part];
    const double bound = bound_mm > 0.0 ? bound_mm : (alone.closed ? 1.0 : 0.05) * box.diagonal();
    const double near = tool_mm + (alone.closed ? 0.0 : bound);
    if (box.distance2(solver.position()) > near * near) return {};
    solver.bind(alone, best_kernels(), tolerances);
    return surface_side(solver, tool(level), bound, counters);
}

// Parts whose surface has the tool behind it, within the bound.
std::uint64_t Renderer::State::parts_behind(std::uint32_t level, double bound_mm, TickCounters& counters) {
    std::uint64_t behind = 0;
    for (std::uint64_t bits = scene.visible(); bits != 0; bits &= bits - 1) {
        const auto i = static_cast<std::uint32_t>(std::countr_zero(bits));
        const SurfaceSide side = side_of_part(level, i, bound_mm, counters);
        if (side.found && side.distance < 0.0) behind |= std::uint64_t{1} << i;
    }
    return behind;
}

// Out of every part that was entered. Each is asked by itself: the nearest surface may be that of a part which the tool
// is outside of, inside another. Leaving one may lead into another, as in the groove where two meet: each push keeps
// free what the pushes before it freed, the least way out of all their planes. Where that leads nowhere, out of all
// parts along a line. Ends bound to the whole level. False: the tool overlaps still.
bool Renderer::State::get_out_of_parts(std::uint32_t level, std::uint64_t entered, std::uint64_t others,
                                       double bound_mm, bool& moved, TickCounters& counters) {
    const auto used = tool(level);
    const Vec3 start = solver.position();
    moved = false;
    bool free = false;
    PlaneSet planes;
    for (;;) {
        SurfaceSide deepest;
        // Placed on a part, the tool may overlap it by what rounding takes.
        double least = moved ? -0.5 * tolerances.skin : 0.0;
        for (std::uint64_t bits = moved ? entered | others : entered; bits != 0; bits &= bits - 1) {
            const auto i = static_cast<std::uint32_t>(std::countr_zero(bits));
            const SurfaceSide side = side_of_part(level, i, bound_mm, counters);
            if (!side.found || side.distance - used[side.ball].kept >= least) continue;
            deepest = side;
            least = side.distance - used[side.ball].kept;
        }
        free = !deepest.found;
        if (free || planes.count == kMaxPlanes) break;
        const SolverBall& ball = used[deepest.ball];
        const Vec3 x = deepest.point + deepest.normal * ball.kept - ball.offset;
        planes.planes[planes.count++] = {deepest.normal, dot(deepest.normal, x - start), deepest.point};
        const PlaneSolution out = nearest_feasible(planes, {}, false, 1e-3 * tolerances.skin);
        moved = true;
        if (!out.feasible) break;
        solver.place(start + out.y);
    }
    solver.bind(scene.at(level), best_kernels(), tolerances);
    if (free) return true;
    solver.place(start);
    return leave_along_a_line(planes.planes[0].normal, extent_mm, used, counters);
}

std::uint64_t Renderer::State::touched_parts() const {
    std::uint64_t parts = 0;
    for (int i = 0; i < contact.active; ++i) parts |= std::uint64_t{1} << contact.planes[i].part;
    return parts;
}

// Parts were hidden, shown or exchanged since the last tick. With the HIP where it was then, as in a level switch: what
// held the tool and is gone lets it go on, what was shown over it counts as a start inside.
void Renderer::State::change_scene(TickCounters& counters) {
    const std::uint64_t before = scene.visible(), entered = wanted & (~before | exchanged);
    const std::uint64_t changed = (wanted ^ before) | entered;
    exchanged = 0;
    scene_changes = false;
    if (wanted != before) scene.show(wanted);
    const std::uint32_t level = level_switch.level();
    solver.bind(scene.at(level), best_kernels(), tolerances);
    probe.reset();
    if (!started || changed == 0) return;
    const bool touching = contact.active > 0, let_go = (touched_parts() & changed) != 0;
    const Vec3 rendered = blend.rendered(contact.scp + shade, norm(contact.scp - hip));
    bool moved = false;
    get_out_of_parts(level, entered, wanted, 0.0, moved, counters);
    if (moved) counters.errors |= kErrStartInside;
    if (!moved && !let_go) return;
    contact.active = 0;  // friction holds nothing of what is gone
    if (!touching) return gate.engage(config.engage_s);
    touch(level, hip, {}, counters);
    const double over_s = moved ? std::max(config.blend_s, config.engage_s) : config.blend_s;
    if (contact.active > 0 && over_s > 0.0) {
        blend.begin(rendered - contact.scp - shade, over_s, norm(contact.scp - hip));
        switched = felt;
    }
}

// First tick: where the tool overlaps the surface, contact begins at the nearest place outside it, softly.
void Renderer::State::start(TickCounters& counters) {
    solver.place(hip);
    // Behind an open sheet is a place to be; inside a closed body is not, however deep.
    bool moved = false;
    if (scene.at(0).visible_count == 1)
        get_out(0, (scene.at(0).closed ? 1.0 : 0.05) * extent_mm, moved, counters);
    else
        get_out_of_parts(0, scene.visible(), 0, 0.0, moved, counters);
    if (!moved) return;
    counters.errors |= kErrStartInside;
    gate.engage(config.engage_s);
}

}  // namespace hapticlod
