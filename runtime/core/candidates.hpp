// The triangles near the tool, gathered once and used for as many ticks as they stay sufficient.
//
// A ball of the tool at offset o with radius r touches triangle T where the tool's reference point is within r of
// T - o. So every (ball, triangle) pair becomes one item: a shifted triangle with a radius, and the whole tool one
// point. Items are complete as long as no ball has moved further than `reach` from where it was: a ball that was clear
// by c then cannot have come within c - s after it moved s. Turning the tool moves balls too, and only shifts items.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "core/kernels.hpp"
#include "core/occupancy.hpp"
#include "core/tool_tree.hpp"
#include "core/vec.hpp"

namespace hapticlod {

struct TickCounters {
    std::uint32_t cells = 0, triangles = 0, tests = 0, iterations = 0, balls = 0, mapping_cells = 0;
    std::uint32_t errors = 0;
};

class Candidates {
public:
    static constexpr std::uint32_t kMaxBlocks = 8192;  // (ball, block) pairs: 65536 items

    // The tree must outlive this; its offsets may turn.
    void allocate(const ToolTree& tree, std::size_t balls);
    void bind(const ActiveLevel& level, const Kernels& kernels);

    // Everything that a ball could touch while it stays within `reach` of where it is with the reference at centre.
    // Items beyond the reach and repeated ones may be among it. Blocks are only listed, with a lower bound of their
    // clearance: most are never looked at. Returns the reach that could be granted (less where the scratch is too
    // small).
    double gather(const Vec3& centre, double reach, std::span<const SolverBall> balls, TickCounters& counters);

    void invalidate() { valid_ = false; }
    // Forget the safe distances too: the level or the tool changed.
    void forget();
    // The tool's balls moved by up to `distance` relative to the reference point. What was listed stays, with less
    // reach; what was placed has to be placed anew.
    void rotated(double distance);

    [[nodiscard]] bool valid() const { return valid_; }
    [[nodiscard]] const Vec3& centre() const { return centre_; }
    // What is left for the reference point to move.
    [[nodiscard]] double reach() const { return reach_ - turned_; }
    [[nodiscard]] std::uint32_t block_count() const { return block_count_; }
    // A block's items, copied out of the level when first asked for.
    [[nodiscard]] const ItemBlock& block(std::uint32_t i) {
        if (stamps_[i] == kListed) place(i);
        return blocks_[slots_[i]];
    }
    // Whether the block was ever evaluated where the tool's orientation was the same.
    [[nodiscard]] bool evaluated(std::uint32_t i) const { return stamps_[i] > kPlaced; }
    [[nodiscard]] EvalBlock& evaluation(std::uint32_t i) { return evaluations_[slots_[i]]; }
    // Lower bound of a block's clearance plus the path length at which it was found.
    [[nodiscard]] double& key(std::uint32_t i) { return keys_[i]; }
    [[nodiscard]] double key(std::uint32_t i) const { return keys_[i]; }
    // Where the evaluation was made (the solver's stamp, above kPlaced).
    static constexpr std::uint32_t kListed = 0, kPlaced = 1;
    [[nodiscard]] std::uint32_t& stamp(std::uint32_t i) { return stamps_[i]; }
    // Lower bound of the tool's clearance at x after a path of that length, as far as the gathers know.
    [[nodiscard]] double clearance_bound(const Vec3& x, double path) const;
    [[nodiscard]] std::size_t bytes() const;

private:
    void place(std::uint32_t i);
    bool gather_node(std::uint32_t node, std::span<const SolverBall> balls, double reach, TickCounters& counters);
    bool gather_balls(std::uint32_t node, std::span<const SolverBall> balls, double reach, TickCounters& counters);
    [[nodiscard]] double empty_within(const Vec3& centre, double outer, TickCounters& counters) const;
    template <class Use>
    void for_cells(const Vec3& centre, double range, TickCounters& counters, Use&& use) const;

    const ActiveLevel* level_ = nullptr;
    const Kernels* kernels_ = nullptr;
    std::vector<ItemBlock> blocks_;  // as far as placed
    std::vector<EvalBlock> evaluations_;
    std::vector<double> keys_;
    std::vector<std::uint32_t> stamps_, slots_;
    struct Source {
        std::uint32_t block, ball;
    };
    std::vector<Source> sources_;
    std::span<const SolverBall> solver_balls_;
    const ToolTree* tree_ = nullptr;
    // A ball (in the tree's order), or all balls below a node, stay clear until the odometer says this.
    std::vector<double> balls_clear_until_, nodes_clear_until_, nodes_looked_at_;
    std::uint32_t block_count_ = 0, placed_ = 0;
    Vec3 centre_;
    double reach_ = 0.0, turned_ = 0.0, odometer_ = 0.0;
    bool valid_ = false;
};

}  // namespace hapticlod
