#include "core/renderer.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/blend.hpp"
#include "core/config_check.hpp"
#include "core/contact.hpp"
#include "core/flush_denormals.hpp"
#include "core/force_gate.hpp"
#include "core/inside.hpp"
#include "core/mapping.hpp"
#include "core/material.hpp"
#include "core/speed.hpp"
#include "core/surface.hpp"
#include "core/switching.hpp"

namespace hapticlod {

struct Renderer::State {
    ConfigData config{};
    std::vector<ActiveLevel> levels;
    std::vector<Vec3> tool_centres;
    std::vector<SolverBall> balls;
    std::vector<Vec3> turned;  // scratch: offsets of the next orientation
    ToolTree tree;
    ToolLinks links;
    Tolerances tolerances;
    double extent_mm = 0.0;

    ContactSolver solver;
    Mapper mapper;
    SpeedEstimator speed;
    LevelSwitch level_switch;
    ProbeDistance probe;
    Blend blend;
    ForceGate gate;

    bool started = false;
    double time_s = 0.0, last_stamp_s = 0.0;
    Vec3 hip;                                 // relative to the origin
    double asked[4] = {1.0, 0.0, 0.0, 0.0};   // orientation of the last pose
    double facing[4] = {1.0, 0.0, 0.0, 0.0};  // and of the tool: a turn that is too large or barred comes later
    Contact contact;
    Vec3 shade;  // what force shading adds to the contact's SCP: the force points from the HIP to scp + shade
    ContactMemory memory;
    bool has_materials = false;  // on any level: without, `felt` stays the station's
    FeltMaterial felt;           // what the force is made with: `touched`, after a level switch `switched` at first
    FeltMaterial touched;        // of the last contact that was not held by friction
    FeltMaterial switched;       // what was felt when the level changed

    [[nodiscard]] std::span<const SolverBall> tool(std::uint32_t level) const {
        return {balls.data(), std::min<std::size_t>(config.balls[level], balls.size())};
    }
    void forget();
    double accept_pose(const Pose& pose, double time_s, TickCounters& counters);
    double probe_distance_mm(TickCounters& counters);
    void turn(const double q[4]);
    void turn_as_asked(double motion_mm, TickCounters& counters);
    bool get_out(std::uint32_t level, double bound_mm, bool& moved, TickCounters& counters);
    void start(TickCounters& counters);
    MappingOutcome switch_level(std::uint32_t from, std::uint32_t to, const Vec3& last_hip, TickCounters& counters);
    MappingOutcome change_level(std::uint32_t from, std::uint32_t to, const Vec3& last_hip, TickCounters& counters);
    void touch(std::uint32_t level, const Vec3& target, const Vec3& motion, TickCounters& counters);
    [[nodiscard]] Vec3 shading(std::uint32_t level) const;
    [[nodiscard]] Vec3 force(const Vec3& pulled_to) const;
};

Renderer::Renderer() : state_(std::make_unique<State>()) {}
Renderer::~Renderer() = default;
Renderer::Renderer(Renderer&&) noexcept = default;
Renderer& Renderer::operator=(Renderer&&) noexcept = default;

std::string Renderer::load(const ConfigData& config, std::span<const LevelView> levels,
                           std::span<const BallData> tool) {
    if (std::string fault = check_config(config); !fault.empty()) return fault;
    if (levels.size() != config.level_count) return "the number of levels differs from level_count";
    if (tool.empty() || tool.size() > kMaxBalls) return "a tool needs 1 to 4096 balls";
    for (const LevelView& level : levels)
        if (level.hash == nullptr || level.triangle_count() == 0) return "a level is empty";
    for (const LevelView& level : levels)
        if (std::string fault = check_materials(level.materials, level.vertex_count()); !fault.empty()) return fault;
    State& s = *state_;
    s.config = config;
    s.levels.clear();
    for (const LevelView& level : levels) s.levels.emplace_back(level);
    s.has_materials =
        std::any_of(levels.begin(), levels.end(), [](const LevelView& l) { return !l.materials.empty(); });
    const HashHeader& h = *levels[0].hash;
    s.extent_mm =
        norm(Vec3{h.bbox_max[0] - h.bbox_min[0], h.bbox_max[1] - h.bbox_min[1], h.bbox_max[2] - h.bbox_min[2]});
    if (!(s.extent_mm > 0.0)) return "level 0 has no extent";
    s.tolerances = Tolerances::of_extent(s.extent_mm);
    // A closed surface has no cracks to bridge.
    const bool closed = std::all_of(s.levels.begin(), s.levels.end(), [](const ActiveLevel& l) { return l.closed; });
    const double crack_mm = closed ? 0.0 : config.crack_mm;
    s.tool_centres.clear();
    s.balls.clear();
    for (const BallData& b : tool) {
        const Vec3 centre = load3(b.centre_mm);
        if (!centre.finite() || !(b.radius_mm >= 0.0) || !std::isfinite(b.radius_mm))
            return "a ball of the tool is not finite or has a negative radius";
        s.tool_centres.push_back(centre);
        const double kept = std::max(b.radius_mm, crack_mm) + s.tolerances.skin;
        s.balls.push_back({centre, b.radius_mm, kept});
    }
    s.turned.resize(s.balls.size());
    s.tree.build(s.tool_centres, s.balls);
    s.links.build(s.tool_centres, s.balls, std::span(config.balls, config.level_count));
    s.solver.allocate(s.tree, s.links, s.balls.size());
    s.solver.limit_work(config.work_limit > 0.0 ? config.work_limit : std::numeric_limits<double>::infinity());
    s.mapper.allocate();
    s.forget();
    return {};
}

void Renderer::State::forget() {
    started = false;
    speed.reset();
    level_switch.reset();
    probe.reset();
    blend.reset();
    gate.reset();
    contact = {};
    const double identity[4] = {1.0, 0.0, 0.0, 0.0};
    turn(identity);
    std::copy(identity, identity + 4, asked);
    felt = touched = FeltMaterial::of_station(config);
    solver.bind(levels[0], best_kernels(), tolerances);
}

void Renderer::reset() noexcept { state_->forget(); }
void Renderer::set_coarsest_floor(std::uint32_t level) noexcept { state_->level_switch.set_floor(level); }
const ConfigData& Renderer::config() const noexcept { return state_->config; }
std::size_t Renderer::scratch_bytes() const noexcept {
    std::size_t size = sizeof(State) + state_->solver.candidates().bytes() + Mapper::bytes();
    for (const ActiveLevel& level : state_->levels) size += level.bytes();
    return size;
}

// Rotates the tool about its reference point.
void Renderer::State::turn(const double q[4]) {
    const Rotation rotation(q);
    double moved2 = 0.0;
    for (std::size_t i = 0; i < balls.size(); ++i) {
        const Vec3 to = rotation * tool_centres[i];
        moved2 = std::max(moved2, norm2(to - balls[i].offset));
        balls[i].offset = to;
    }
    tree.turn(rotation, balls);
    std::copy(q, q + 4, facing);
    if (moved2 > 0.0) solver.rotated(std::sqrt(moved2)), probe.moved(std::sqrt(moved2));
}

// From the tool to the surface of the level in use, as near as the thresholds need it; 0 in contact.
double Renderer::State::probe_distance_mm(TickCounters& counters) {
    if (contact.active > 0) {
        probe.seen(0.0);
    } else if (!probe.decides(config)) {
        const double bound = ProbeDistance::bound_mm(config);
        const auto used = tool(level_switch.level());
        const SurfaceSide side = surface_side(solver, used, bound, counters, 0.0);
        const double clear = side.found ? std::abs(side.distance) - used[side.ball].kept : bound;
        probe.seen(std::clamp(clear, 0.0, bound));
    }
    return probe.mm();
}

// Turns the tool where it is; whatever a ball would pass through moves the tool instead. A large turn takes several
// ticks, and one that cannot be resolved now is tried again.
void Renderer::State::turn_as_asked(double motion_mm, TickCounters& counters) {
    const auto used = tool(level_switch.level());
    const Rotation whole(asked);
    double longest2 = 0.0;
    for (std::size_t i = 0; i < used.size(); ++i)
        longest2 = std::max(longest2, norm2(whole * tool_centres[i] - used[i].offset));
    const double longest = std::sqrt(longest2);
    if (longest == 0.0 || longest < solver.clearance()) return turn(asked);
    double part = std::min(std::max(solver.mean_edge_mm(), 3.0 * motion_mm) / longest, 1.0);
    for (int attempt = 0; attempt < 3; ++attempt, part *= 0.25) {
        double q[4];
        part_of_turn(facing, asked, part, q);
        if (part == 1.0) std::copy(asked, asked + 4, q);
        const Rotation rotation(q);
        for (std::size_t i = 0; i < used.size(); ++i) turned[i] = rotation * tool_centres[i];
        const Vec3 before = solver.position();
        if (!solver.make_way(used, std::span<const Vec3>(turned).first(used.size()), motion_mm, counters)) continue;
        contact.scp += solver.position() - before;  // what friction holds gives way with it
        if (part < 1.0) counters.errors |= kErrTurnHeld;
        return turn(q);
    }
    counters.errors |= kErrTurnHeld;
}

// Takes position, orientation and time where they are valid, and says how long the period was.
double Renderer::State::accept_pose(const Pose& pose, double now_s, TickCounters& counters) {
    const double nominal = 1.0 / config.loop_hz;
    double dt = nominal;
    if (started) {
        dt = now_s - time_s;
        if (!(dt > 0.0) || !std::isfinite(dt)) {
            // One wrong stamp is passed over; a clock that was set back goes on from where it is now.
            const double since = now_s - last_stamp_s;
            const bool set_back = since > 0.0 && since < 10.0 * nominal;
            dt = set_back ? since : nominal;
            if (!set_back) counters.errors |= kErrPeriod;
            time_s = set_back ? now_s : time_s + nominal;
        } else {
            time_s = now_s;
        }
    } else {
        time_s = std::isfinite(now_s) ? now_s : 0.0;
    }
    last_stamp_s = now_s;
    const double* q = pose.orientation;
    const double length2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    const Vec3 position = load3(pose.position_mm) - load3(config.origin_mm);
    // Nor is a place so far off that its square overflows: path lengths would be spoilt for good.
    if (!(norm2(position) < 1e18) || !(std::abs(length2 - 1.0) < 1e-2)) {
        counters.errors |= kErrHipNotFinite;
        return dt;
    }
    if (started && norm(position - hip) > extent_mm) {
        counters.errors |= kErrHipJump;
        forget();
    }
    const double motion_mm = started ? norm(position - hip) : 0.0;
    hip = position;
    const double scale = 1.0 / std::sqrt(length2);
    for (int k = 0; k < 4; ++k) asked[k] = std::abs(length2 - 1.0) < 1e-15 ? q[k] : q[k] * scale;
    if (!std::equal(asked, asked + 4, facing)) {
        if (!started)
            turn(asked);
        else
            turn_as_asked(motion_mm, counters);
    }
    return dt;
}

// Where the tool overlaps the surface or is inside it: out, to the nearest place in front of it. False: it overlaps
// still. `moved` says whether it had to.
bool Renderer::State::get_out(std::uint32_t level, double bound_mm, bool& moved, TickCounters& counters) {
    const auto used = tool(level);
    const SurfaceSide side = surface_side(solver, used, bound_mm, counters);
    moved = side.found && side.distance < used[side.ball].kept;
    if (!moved || place_on_closest(solver, used, 2.0 * bound_mm, nullptr, counters)) return true;
    // Its balls want out on different sides, of a thin plate perhaps: any straight way out will do, a short one first.
    double size = 0.0;
    for (const SolverBall& ball : used) size = std::max(size, norm(ball.offset) + ball.kept);
    const double longest = levels[level].closed ? extent_mm : bound_mm;
    const Vec3 n = side.normal;
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

// First tick: where the tool overlaps the surface, contact begins at the nearest place outside it, softly.
void Renderer::State::start(TickCounters& counters) {
    solver.place(hip);
    // Behind an open sheet is a place to be; inside a closed body is not, however deep.
    bool moved = false;
    get_out(0, (levels[0].closed ? 1.0 : 0.05) * extent_mm, moved, counters);
    if (!moved) return;
    counters.errors |= kErrStartInside;
    gate.engage(config.engage_s);
}

MappingOutcome Renderer::State::change_level(std::uint32_t from, std::uint32_t to, const Vec3& last_hip,
                                             TickCounters& counters) {
    const bool paper = config.mapping == static_cast<std::uint32_t>(Mapping::paper);
    if (contact.active == 0) {
        // In free space, but outside this level may be inside the next: the tool must not start behind it.
        const double bound = paper ? 0.0 : config.closest_bound_mm;
        if (bound > 0.0) {
            const SurfaceSide before = surface_side(solver, tool(from), bound, counters);
            solver.bind(levels[to], best_kernels(), tolerances);
            bool moved = false;
            if (!before.found || before.distance >= 0.0) get_out(to, bound, moved, counters);
        } else {
            solver.bind(levels[to], best_kernels(), tolerances);
        }
        return MappingOutcome::none;
    }
    solver.bind(levels[to], best_kernels(), tolerances);
    if (paper) return Mapper::paper(solver, levels[to].view, memory, config.l_out_mm, counters);
    const MappingOutcome outcome =
        mapper.two_sided(solver, memory, config.l_in_mm, config.l_out_mm, config.closest_bound_mm, tool(to), counters);
    if (outcome == MappingOutcome::miss) {
        // Where it was it may well be free on this level: then it goes on from there.
        counters.errors |= kErrContactLost;
        const double longest = std::max({config.l_in_mm, config.l_out_mm, config.closest_bound_mm});
        bool moved = false;
        if (!get_out(to, levels[to].closed ? extent_mm : 2.0 * longest, moved, counters)) solver.place(last_hip);
        if (moved) gate.engage(config.engage_s);
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

// Contact at the target with Coulomb friction: the SCP holds until the pull leaves the static cone, then trails the
// frictionless SCP at the radius of the dynamic cone (Harwin & Melder 2002).
void Renderer::State::touch(std::uint32_t level, const Vec3& target, const Vec3& motion, TickCounters& counters) {
    const bool held = contact.active > 0;
    const Vec3 from = solver.position(), anchor = contact.scp;
    Contact free = solver.advance(target, tool(level), motion, counters);
    bool stuck = false;
    if (felt.friction_static > 0.0 && held && free.active > 0) {
        const double depth = norm(free.scp - target), pull = norm(free.scp - anchor);
        if (pull <= felt.friction_static * depth) {
            solver.place(from);
            free.scp = anchor;
            stuck = true;
        } else if (felt.friction_dynamic > 0.0 && pull > 0.0) {
            const double trail = std::min(felt.friction_dynamic * depth / pull, 1.0);
            solver.place(from);
            const Contact slid = solver.advance(target + (anchor - free.scp) * trail, tool(level), motion, counters);
            if (slid.active > 0) free = slid;
        }
    }
    contact = free;
    shade = {};
    if (contact.active == 0) return;
    if (contact.between) return;
    if (has_materials && !stuck)  // where friction holds the tool, it stays on what it lies on
        touched = contact_material(levels[level].view, config, contact, solver, tool(level), counters);
    shade = shading(level);
    int strongest = 0;
    for (int i = 1; i < contact.active; ++i)
        if (contact.multiplier[i] > contact.multiplier[strongest]) strongest = i;
    const ContactPlane& p = contact.planes[strongest];
    const Vec3 d = contact.scp - target;
    const double depth = norm(d);
    memory.normal = depth > 0.0 ? d * (1.0 / depth) : p.normal;
    memory.point = p.point;
    memory.ball = p.ball;
    memory.side = contact.behind[strongest] ? -1.0 : 1.0;
}

// The part of the force that the faces give, turned from their normals to the interpolated ones. Friction is left
// alone.
Vec3 Renderer::State::shading(std::uint32_t level) const {
    if (config.shading == 0) return {};
    Vec3 faces, sum;
    for (int i = 0; i < contact.active; ++i) {
        const ContactPlane& p = contact.planes[i];
        faces += p.normal * contact.multiplier[i];
        sum += shaded_normal(levels[level].view, p.triangle, p.point, p.normal) * contact.multiplier[i];
    }
    const double length = norm(sum);
    return length > 0.0 ? sum * (norm(faces) / length) - faces : Vec3{};
}

Vec3 Renderer::State::force(const Vec3& pulled_to) const {
    const Vec3 d = pulled_to - hip;
    const Vec3 spring = d * felt.stiffness_n_mm;
    const Vec3 damped = spring - speed.velocity() * config.damping_n_s_mm;
    // Damping resists; it never pulls the tool onto the surface.
    const double size2 = norm2(d);
    const double along = dot(damped, d);
    return size2 > 0.0 && along < 0.0 ? damped - d * (along / size2) : damped;
}

void Renderer::tick(const Pose& pose, double time_s, TickRecord& out) noexcept {
    const FlushDenormals flush;
    State& s = *state_;
    out = TickRecord{};
    out.time_s = time_s;
    TickCounters counters;
    const Vec3 last_hip = s.hip;
    const bool first = !s.started;
    const double dt = s.accept_pose(pose, time_s, counters);
    if (!s.started && (counters.errors & kErrHipNotFinite) != 0) {
        out.errors = counters.errors;
        return;
    }
    if (!s.started) {
        s.started = true;
        s.start(counters);
    }
    const Vec3 motion = first ? Vec3{} : s.hip - last_hip;

    const Vec3 velocity = s.speed.update(s.hip, dt, s.config.filter_hz);
    const double speed_mm_s = norm(velocity);
    const bool by_distance = s.config.policy == static_cast<std::uint32_t>(Policy::distance);
    const double measure = by_distance ? s.probe_distance_mm(counters) : speed_mm_s;
    s.probe.moved(norm(motion));
    const std::uint32_t before = s.level_switch.level();
    const std::uint32_t level = s.level_switch.update(s.config, measure, dt);
    MappingOutcome outcome = MappingOutcome::none;
    if (level != before) outcome = s.switch_level(before, level, last_hip, counters);
    s.touch(level, s.hip, motion, counters);

    Vec3 force, scp = s.contact.scp;
    if (s.contact.active > 0) {
        const Vec3 pulled_to = s.blend.rendered(s.contact.scp + s.shade, norm(s.contact.scp - s.hip));
        scp = pulled_to - s.shade;
        if (s.has_materials) s.felt = between(s.touched, s.switched, s.blend.share());
        force = s.force(pulled_to);
    } else {
        s.blend.reset();
    }
    s.blend.advance(dt);
    force = s.gate.apply(s.config, force, dt, counters.errors);

    Vec3 torque;
    for (int i = 0; i < s.contact.active; ++i)
        torque += cross(s.contact.planes[i].point - s.contact.scp,
                        s.contact.planes[i].normal * (s.contact.multiplier[i] * s.felt.stiffness_n_mm));
    const Vec3 origin = load3(s.config.origin_mm);
    (s.hip + origin).store(out.hip_mm);
    (scp + origin).store(out.scp_mm);
    force.store(out.force_n);
    torque.store(out.torque_n_mm);
    out.speed_mm_s = static_cast<float>(speed_mm_s);
    out.level = static_cast<std::uint8_t>(level);
    out.contact = s.contact.active > 0 ? 1 : 0;
    out.mapping = static_cast<std::uint8_t>(outcome);
    out.constraints = static_cast<std::uint8_t>(s.contact.active);
    out.errors = counters.errors;
    out.cells = counters.cells;
    out.triangles = counters.triangles;
    out.tests = counters.tests;
    out.iterations = counters.iterations;
    out.balls = counters.balls;
    out.mapping_cells = counters.mapping_cells;
}

}  // namespace hapticlod
