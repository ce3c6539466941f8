#include "core/renderer.hpp"

#include <algorithm>
#include <cmath>

#include "core/config_check.hpp"
#include "core/flush_denormals.hpp"
#include "core/renderer_state.hpp"
#include "core/surface.hpp"

namespace hapticlod {

Renderer::Renderer() : state_(std::make_unique<State>()) {}
Renderer::~Renderer() = default;
Renderer::Renderer(Renderer&&) noexcept = default;
Renderer& Renderer::operator=(Renderer&&) noexcept = default;

std::string Renderer::load(const ConfigData& config, std::span<const LevelView> levels,
                           std::span<const BallData> tool) {
    if (std::string fault = check_config(config); !fault.empty()) return fault;
    if (levels.size() != config.level_count) return "the number of levels differs from level_count";
    auto own = std::make_unique<Part>(levels);
    const Part* const only = own.get();
    if (std::string fault = load_scene(config, {&only, 1}, 1, tool); !fault.empty()) return fault;
    state_->own = std::move(own);
    return {};
}

std::string Renderer::load_scene(const ConfigData& config, std::span<const Part* const> parts, std::uint64_t visible,
                                 std::span<const BallData> tool) {
    if (std::string fault = check_config(config); !fault.empty()) return fault;
    if (tool.empty() || tool.size() > kMaxBalls) return "a tool needs 1 to 4096 balls";
    if (parts.empty() || parts.size() > kMaxParts) return "a scene needs 1 to 64 parts";
    for (const Part* part : parts) {
        if (!part->fault().empty()) return part->fault();
        if (part->level_count() > config.level_count) return "a part has more levels than level_count";
    }
    State& s = *state_;
    s.config = config;
    s.own.reset();
    s.wanted = visible & all_parts(static_cast<std::uint32_t>(parts.size()));
    s.exchanged = 0;
    s.scene_changes = false;
    s.scene.load(parts, s.wanted, config.level_count);
    s.box = {};
    for (const Part* part : parts) s.box.add(part->box());
    s.has_materials = std::any_of(parts.begin(), parts.end(), [](const Part* p) { return p->has_materials(); });
    s.extent_mm = s.box.diagonal();
    if (!(s.extent_mm > 0.0)) return "level 0 has no extent";
    s.tolerances = Tolerances::of_extent(s.extent_mm);
    // A closed surface has no cracks to bridge.
    s.bridges = !std::all_of(parts.begin(), parts.end(), [](const Part* p) { return p->closed(); });
    const double crack_mm = s.bridges ? config.crack_mm : 0.0;
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
    s.tool_mm = 0.0;
    for (const SolverBall& ball : s.balls) s.tool_mm = std::max(s.tool_mm, norm(ball.offset) + ball.kept);
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
    solver.bind(scene.at(0), best_kernels(), tolerances);
}

void Renderer::reset() noexcept { state_->forget(); }
void Renderer::set_coarsest_floor(std::uint32_t level) noexcept { state_->level_switch.set_floor(level); }
const ConfigData& Renderer::config() const noexcept { return state_->config; }
std::size_t Renderer::scratch_bytes() const noexcept {
    std::size_t size = sizeof(State) + state_->solver.candidates().bytes() + Mapper::bytes();
    size += state_->scene.bytes();
    for (std::uint32_t i = 0; i < state_->scene.part_count(); ++i) size += state_->scene.part(i).bytes();
    return size;
}

void Renderer::show(std::uint64_t visible) noexcept {
    state_->wanted = visible & all_parts(state_->scene.part_count());
    state_->scene_changes = true;
}
std::uint64_t Renderer::visible() const noexcept { return state_->wanted; }
std::uint64_t Renderer::touched() const noexcept { return state_->touched_parts(); }

std::string Renderer::refusal(std::uint32_t part, const Part& next) const {
    const State& s = *state_;
    if (part >= s.scene.part_count()) return "there is no such part";
    if (next.level_count() > s.config.level_count) return "the part has more levels than the scene";
    if (std::string fault = next.fault(); !fault.empty()) return fault;
    if (!next.closed() && !s.bridges && s.config.crack_mm > 0.0)
        return "the part has open borders, and the scene was loaded without any: its cracks would not be bridged";
    Box box = next.box();
    box.add(s.box);
    if (box.diagonal() > 2.0 * s.extent_mm)
        return "the part reaches far beyond the scene: its tolerances would not fit";
    return {};
}

const Part* Renderer::exchange(std::uint32_t part, const Part& next) noexcept {
    State& s = *state_;
    if (part >= s.scene.part_count() || next.level_count() > s.config.level_count) return nullptr;
    s.exchanged |= std::uint64_t{1} << part;
    s.scene_changes = true;
    s.has_materials = s.has_materials || next.has_materials();
    s.solver.candidates().invalidate();
    return s.scene.exchange(part, &next);
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

// Contact at the target with Coulomb friction: the SCP holds until the pull leaves the static cone, then trails the
// frictionless SCP at the radius of the dynamic cone (Harwin & Melder 2002).
void Renderer::State::touch(std::uint32_t level, const Vec3& target, const Vec3& motion, TickCounters& counters) {
    const bool held = contact.active > 0;
    const Vec3 from = solver.position(), anchor = contact.scp;
    solver.advance(target, tool(level), motion, counters, contact);
    bool stuck = false;
    if (felt.friction_static > 0.0 && held && contact.active > 0) {
        const double depth = norm(contact.scp - target), pull = norm(contact.scp - anchor);
        if (pull <= felt.friction_static * depth) {
            solver.place(from);
            contact.scp = anchor;
            stuck = true;
        } else if (felt.friction_dynamic > 0.0 && pull > 0.0) {
            const double trail = std::min(felt.friction_dynamic * depth / pull, 1.0);
            solver.place(from);
            Contact slid;
            solver.advance(target + (anchor - contact.scp) * trail, tool(level), motion, counters, slid);
            if (slid.active > 0) contact = slid;
        }
    }
    shade = {};
    if (contact.active == 0) return;
    if (contact.between) return;
    if (has_materials && !stuck)  // where friction holds the tool, it stays on what it lies on
        touched = contact_material(config, contact, solver, tool(level), counters);
    shade = shading();
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
Vec3 Renderer::State::shading() const {
    if (config.shading == 0) return {};
    Vec3 faces, sum;
    for (int i = 0; i < contact.active; ++i) {
        const ContactPlane& p = contact.planes[i];
        faces += p.normal * contact.multiplier[i];
        sum += shaded_normal(view(p), p.triangle, p.point, p.normal) * contact.multiplier[i];
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
    TickCounters counters;
    const Vec3 last_hip = s.hip;
    const bool first = !s.started;
    if (s.scene_changes) s.change_scene(counters);
    const double dt = s.accept_pose(pose, time_s, counters);
    if (!s.started && (counters.errors & kErrHipNotFinite) != 0) {
        out = TickRecord{};
        out.time_s = time_s;
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
    // Every field: to clear the record first would take longer.
    out.time_s = time_s;
    (s.hip + origin).store(out.hip_mm);
    (scp + origin).store(out.scp_mm);
    force.store(out.force_n);
    torque.store(out.torque_n_mm);
    out.speed_mm_s = static_cast<float>(speed_mm_s);
    out.cost_ns = 0.0f;
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
