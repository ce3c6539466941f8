// What a Renderer keeps from tick to tick, and the steps of a tick; for renderer*.cpp alone.
#pragma once
#include <vector>

#include "core/blend.hpp"
#include "core/contact.hpp"
#include "core/force_gate.hpp"
#include "core/inside.hpp"
#include "core/mapping.hpp"
#include "core/material.hpp"
#include "core/renderer.hpp"
#include "core/speed.hpp"
#include "core/switching.hpp"

namespace hapticlod {

struct Renderer::State {
    ConfigData config{};
    std::unique_ptr<Part> own;  // of load(): the only part
    Scene scene;
    Box box;                                  // of all parts, as they were loaded
    std::uint64_t wanted = 0, exchanged = 0;  // what the next tick begins with
    bool scene_changes = false;
    bool bridges = false;  // the tool keeps the crack width
    std::vector<Vec3> tool_centres;
    std::vector<SolverBall> balls;
    std::vector<Vec3> turned;  // scratch: offsets of the next orientation
    double tool_mm = 0.0;      // no ball reaches further from the reference point, however the tool is turned
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
    bool has_materials = false;  // on any part: without, `felt` stays the station's
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
    bool leave_along_a_line(const Vec3& n, double longest, std::span<const SolverBall> used, TickCounters& counters);
    bool get_out_of_parts(std::uint32_t level, std::uint64_t entered, std::uint64_t others, double bound_mm,
                          bool& moved, TickCounters& counters);
    SurfaceSide side_of_part(std::uint32_t level, std::uint32_t part, double bound_mm, TickCounters& counters);
    std::uint64_t parts_behind(std::uint32_t level, double bound_mm, TickCounters& counters);
    [[nodiscard]] std::uint64_t touched_parts() const;
    [[nodiscard]] const LevelView& view(const ContactPlane& p) const { return solver.shown().surfaces[p.part]->view; }
    void change_scene(TickCounters& counters);
    void start(TickCounters& counters);
    MappingOutcome switch_level(std::uint32_t from, std::uint32_t to, const Vec3& last_hip, TickCounters& counters);
    MappingOutcome change_level(std::uint32_t from, std::uint32_t to, const Vec3& last_hip, TickCounters& counters);
    void touch(std::uint32_t level, const Vec3& target, const Vec3& motion, TickCounters& counters);
    [[nodiscard]] Vec3 shading() const;
    [[nodiscard]] Vec3 force(const Vec3& pulled_to) const;
};

}  // namespace hapticlod
