// A tool's balls in a tree of bounding spheres, eight to a node, so that a tick looks at what is near, not at what
// exists. Offsets turn with the tool.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "core/kernels.hpp"
#include "core/vec.hpp"

namespace hapticlod {

// A ball as the solver sees it: offset from the reference point in the scan's orientation, and the distance its
// centre keeps (never below the skin, so that a point has an outside and an inside).
struct SolverBall {
    Vec3 offset;
    double radius = 0.0;  // of the tool
    double kept = 0.0;    // max(radius, crack) + skin
};

class ToolTree {
public:
    struct Node {
        Vec3 centre, offset;      // tool frame, and turned
        double radius = 0.0;      // holds every kept ball below
        std::uint32_t first = 0;  // first child: a node, or a place in order() for a leaf's parent
        std::uint32_t count = 0;
        std::uint32_t least_ball = 0;  // lowest ball index below: a level uses the first P balls
        bool above_balls = false;
    };

    void build(std::span<const Vec3> centres, std::span<const SolverBall> balls);
    // The balls' offsets have turned.
    void turn(const Rotation& rotation, std::span<const SolverBall> balls);

    [[nodiscard]] std::span<const Node> nodes() const { return nodes_; }
    [[nodiscard]] std::uint32_t root() const { return static_cast<std::uint32_t>(nodes_.size()) - 1; }
    [[nodiscard]] std::uint32_t ball(std::uint32_t place) const { return order_[place]; }
    // The balls of a node above balls (those come first), relative to the node's offset; unused lanes repeat the first.
    [[nodiscard]] const BallPack& pack(std::uint32_t node) const { return packs_[node]; }

private:
    std::vector<Node> nodes_;           // children before parents; the root is last
    std::vector<std::uint32_t> order_;  // ball indices along a Morton curve
    std::vector<BallPack> packs_;       // one per node above balls

    void pack_up(std::span<const SolverBall> balls);
};

}  // namespace hapticlod
