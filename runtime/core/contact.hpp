// Constraint-based god object for a rigid union of balls (Zilles & Salisbury 1995; a ball of radius r: Ruspini et al.
// 1997), solved to convergence every tick. The definition and its invariants: docs/contact.md.
//
// One step: planes of everything touched at x (nearest first; a triangle that the planes so far already separate adds
// none), the point y nearest to the HIP behind no plane (plane_qp), a sweep x -> y that stops at the first triangle
// met. Repeated until y = x. Every step is collision-free and shortens the distance to the HIP.
#pragma once
#include <array>
#include <limits>
#include <span>
#include <vector>

#include "core/candidates.hpp"
#include "core/plane_qp.hpp"
#include "core/tool_links.hpp"

namespace hapticlod {

// Lengths that decide contact, all relative to the model's extent.
struct Tolerances {
    double skin = 0.0;      // what a resting ball keeps beyond its radius
    double covered = 0.0;   // a triangle may rise above a plane by this and still count as separated by it
    double touching = 0.0;  // clearance (from the kept distance) under which a triangle is a constraint
    double settled = 0.0;   // a step shorter than this ends the solve

    static Tolerances of_extent(double extent_mm) {
        const double skin = 4e-6 * extent_mm;
        return {skin, 0.25 * skin, skin, 0.02 * skin};
    }
};

// First parameter t in [0, 1] at which p + t step comes within `keep` of the triangle; 2 where it never does.
// Distance to a convex set is convex along a line, so Newton from the left never overshoots the first root.
[[nodiscard]] double time_of_touch(const Triangle& triangle, const Vec3& p, const Vec3& step, double keep,
                                   double precision);

// One ball's nearest surface point, as surface_side() finds it.
struct BallSide {
    static constexpr std::uint32_t kMostAround = 32;  // triangles around one vertex
    static constexpr std::uint32_t kNone = ~0u;
    double distance = 0.0;
    double empty = 0.0;       // no surface is nearer to its centre than this
    double seen = 0.0;        // which side it is on and how clearly: 1 in front, -1 behind, 0 not known
    std::uint32_t first = 0;  // the candidate that may be nearest
    Vec3 point, normal;       // angle-weighted, not normalised
    std::uint32_t around = 0;
    std::array<std::uint64_t, kMostAround> counted;  // part and triangle
};

struct Contact {
    Vec3 scp;        // nearest feasible point without the skin: what force is computed from
    int active = 0;  // constraints, 0..3
    ContactPlane planes[3];
    double multiplier[3] = {};  // scp = hip + sum multiplier_k planes[k].normal
    bool behind[3] = {};        // the ball is where the triangle's winding says inside
    bool converged = true;
    bool between = false;  // cut short on the way from one contact to the next: planes[0] is made up
};

class ContactSolver {
public:
    // Both must outlive this.
    void allocate(const ToolTree& tree, const ToolLinks& links, std::size_t balls) {
        candidates_.allocate(tree, balls);
        links_ = &links;
        touches_.resize(kMaxTouches);
        sides_.resize(balls);
    }
    void bind(const SceneLevel& level, const Kernels& kernels, const Tolerances& tolerances);

    // A tick that has done so much work is cut short: its SCP is safe but not final. Infinite: never.
    void limit_work(double limit) { work_limit_ = limit; }

    // Place the reference point without sweeping (free space, or a mapped contact).
    void place(const Vec3& x) {
        path_ += norm(x - x_);
        x_ = x;
    }
    // The balls will be at `offsets`: moves the reference point by the least translation that lets every ball go there
    // along its chord without passing through the surface. False: that cannot be had now, and nothing was moved.
    bool make_way(std::span<const SolverBall> balls, std::span<const Vec3> offsets, double motion_mm,
                  TickCounters& counters);
    // Lower bound of the distance to the surface where the tool is.
    [[nodiscard]] double clearance() const {
        return candidates_.valid() ? candidates_.clearance_bound(x_, path_) : 0.0;
    }
    // The balls were turned, none by more than this.
    void rotated(double distance) {
        path_ += distance;
        candidates_.rotated(distance);
    }
    [[nodiscard]] const Vec3& position() const { return x_; }

    // Move from the present position toward the HIP as far as the surface lets. `motion` of the HIP since the last tick
    // is a hint of where the tool is going.
    void advance(const Vec3& hip, std::span<const SolverBall> balls, const Vec3& motion, TickCounters& counters,
                 Contact& out);

    // Everything that touches the tool where advance() left it, at its clearance: also what an active plane hides
    // because it lies behind it. Points are relative to the candidates' centre. Looks again, so ask only where it is
    // needed.
    struct Touch {
        double clearance;
        ContactPlane plane;
    };
    [[nodiscard]] std::span<const Touch> touches(std::span<const SolverBall> balls, TickCounters& counters);

    // Lists what is near the present position, or a point ahead of it, see Candidates::gather.
    double gather(double reach, std::span<const SolverBall> balls, TickCounters& counters, const Vec3& ahead = {});
    Candidates& candidates() { return candidates_; }
    [[nodiscard]] const SceneLevel& shown() const { return candidates_.level(); }
    // Between a gather about the present position and the next move: what a pair looks like from there.
    void begin_looking() {
        next_stamp();
        local_ = x_ - candidates_.centre();
    }
    const EvalBlock& look(std::uint32_t i, TickCounters& counters) {
        if (candidates_.stamp(i) != stamp_) renew(i, counters);
        return candidates_.evaluation(i);
    }
    // Lanes of a pair that was looked at which the move, there or back, may touch: their planes do not keep the ball
    // clear by the margin.
    [[nodiscard]] std::uint32_t may_touch(std::uint32_t i, const Vec3& move, double margin) const {
        const float there[3] = {static_cast<float>(move.x), static_cast<float>(move.y), static_cast<float>(move.z)};
        const float back[3] = {-there[0], -there[1], -there[2]};
        const EvalBlock& e = candidates_.evaluation(i);
        const auto least = static_cast<float>(margin);
        return kernels_->crossed(e, there, least) | kernels_->crossed(e, back, least);
    }
    [[nodiscard]] std::span<BallSide> sides() { return sides_; }
    [[nodiscard]] const ToolLinks& links() const { return *links_; }
    [[nodiscard]] const Tolerances& tolerances() const { return tolerances_; }
    [[nodiscard]] bool closed() const { return candidates_.level().closed; }
    [[nodiscard]] double cell_mm() const { return cell_mm_; }
    [[nodiscard]] double mean_edge_mm() const { return mean_edge_mm_; }

private:
    static constexpr std::size_t kMaxTouches = 256;

    [[nodiscard]] double wanted_reach(double motion_mm) const;
    double gather_ahead(const Vec3& motion, std::span<const SolverBall> balls, TickCounters& counters);
    // Whether everything within touching distance of x is among the candidates.
    [[nodiscard]] bool candidates_hold(const Vec3& x) const {
        return candidates_.valid() && norm(x - candidates_.centre()) <= candidates_.reach() - 2.0 * tolerances_.skin;
    }
    void renew(std::uint32_t block, TickCounters& counters);
    // From where the block was evaluated to where its ball is with the reference point at `local`.
    [[nodiscard]] std::array<float, 3> move_since(std::uint32_t i, const Vec3& local, const SolverBall& ball) const {
        const Vec3 move = (candidates_.centre() - load3(candidates_.evaluation(i).origin)) + local + ball.offset;
        return {static_cast<float>(move.x), static_cast<float>(move.y), static_cast<float>(move.z)};
    }
    [[nodiscard]] double granted_here(std::uint32_t i, const SolverBall& ball);
    [[nodiscard]] double bounded_here(std::uint32_t i);
    // sole_plane.cpp: planes of what touches at local_ where that is one plane, or none. A step of proven_ along the
    // plane, or in the air, needs no sweep.
    [[nodiscard]] bool on_proven_face(std::span<const SolverBall> balls, const Vec3& target, TickCounters& counters);
    [[nodiscard]] bool find_sole_plane(std::span<const SolverBall> balls, const Vec3& target, double ahead_mm,
                                       TickCounters& counters);
    [[nodiscard]] Triangle triangle_of(const ContactPlane& plane, const SolverBall& ball) const;
    void collect_touching(std::span<const SolverBall> balls, TickCounters& counters);
    [[nodiscard]] bool gather_further(double& wanted, std::span<const SolverBall> balls, TickCounters& counters);
    [[nodiscard]] bool travel(Vec3 step, double& wanted, int& iteration, std::span<const SolverBall> balls,
                              TickCounters& counters);
    [[nodiscard]] double sweep(const Vec3& step, std::span<const SolverBall> balls, TickCounters& counters);
    [[nodiscard]] bool still_planes(const Contact& contact, std::span<const SolverBall> balls);
    [[nodiscard]] bool separated(const Triangle& t, double kept) const;

    Candidates candidates_;
    Candidates::Around around_;
    const ToolLinks* links_ = nullptr;
    const Kernels* kernels_ = nullptr;
    Tolerances tolerances_;
    double mean_edge_mm_ = 0.0, cell_mm_ = 0.0;
    Vec3 x_;
    Vec3 local_;  // x relative to the candidates' centre, at the last evaluation
    double work_limit_ = std::numeric_limits<double>::infinity();
    double proven_ = 0.0;
    // A face that a ball lay on, and how far around where the ball's centre was then no triangle rises above the face.
    struct ProvenFace {
        static constexpr std::uint32_t kNoFace = 0xffffffffu;
        std::uint32_t triangle = kNoFace;
        std::uint16_t part = 0;
        bool behind = false;      // the normal is not the winding's
        Triangle corners;         // relative to the level's origin
        Vec3 normal;              // to the ball's side
        Vec3 weight_b, weight_c;  // of a place relative to corner a: its foot's barycentric weights
        Vec3 place;               // of the ball's centre
        Vec3 ahead;               // proven within the radius of the way from there, so far
        double ahead_inverse2 = 0.0, radius = 0.0;

        [[nodiscard]] bool below(const Vec3& p) const;  // the foot of p is on the face
        [[nodiscard]] bool covers(const Vec3& p, double margin) const;
    };
    void keep_face(std::uint32_t triangle, std::uint16_t part, const Triangle& corners, const Vec3& towards);
    // glide.cpp
    [[nodiscard]] bool glide(const Vec3& hip, const SolverBall& ball, const Vec3& motion, TickCounters& counters,
                             Contact& out);
    [[nodiscard]] bool glide_on(const Vec3& hip, const SolverBall& ball, const Vec3& motion, TickCounters& counters,
                                Contact& out);
    [[nodiscard]] bool find_face(const Vec3& at, const Vec3& ahead, const SolverBall& ball, TickCounters& counters);
    ProvenFace face_;
    std::uint32_t paused_ = 0, pause_ = 1, looked_ = 0;  // of glide(): ticks in which it does not look for faces
    bool sole_ = false;                                  // one plane held the tool when it was last looked for
    double path_ = 0.0;                                  // length moved since the gather, turns included
    std::uint32_t stamp_ =
        Candidates::kListed;  // names the present local_: what carries it need not be evaluated again

    void next_stamp() {
        if (++stamp_ == Candidates::kListed) ++stamp_;
    }
    PlaneSet planes_;
    ContactPlane last_touch_;
    bool touched_ = false;
    std::vector<Touch> touches_;
    std::size_t touch_count_ = 0;
    std::vector<BallSide> sides_;
};

}  // namespace hapticlod
