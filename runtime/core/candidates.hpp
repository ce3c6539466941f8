// The triangles near the tool, gathered once and used for as many ticks as they stay sufficient.
//
// A ball of the tool at offset o with radius r touches triangle T where the tool's reference point is within r of
// T - o. So every (ball, triangle) pair becomes one item: a shifted triangle with a radius, and the whole tool one
// point. Items are complete within `reach` of the point they were gathered at: a ball that was clear by c then cannot
// have come within c - s after the reference moved s.
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
    static constexpr std::uint32_t kMaxBlocks = 4096;  // 32768 items

    // The tree must outlive this; its offsets may turn.
    void allocate(const ToolTree& tree, std::size_t balls);
    void bind(const ActiveLevel& level, const Kernels& kernels);

    // Everything that a ball could touch while the reference point stays within `reach` of centre. Items beyond the
    // reach and repeated ones may be among it. Blocks are only listed, with a lower bound of their clearance: most are
    // never looked at. Returns the reach that could be granted (less where the scratch is too small). The balls must
    // stay where they are for as long as the candidates are used.
    double gather(const Vec3& centre, double reach, std::span<const SolverBall> balls, TickCounters& counters);

    void invalidate() { valid_ = false; }
    // Forget the safe distances too: the level or the tool changed.
    void forget();
    // The tool's balls moved by up to `distance` relative to the reference point (rotation).
    void rotated(double distance) { odometer_ += distance, valid_ = false; }

    [[nodiscard]] bool valid() const { return valid_; }
    [[nodiscard]] const Vec3& centre() const { return centre_; }
    [[nodiscard]] double reach() const { return reach_; }
    [[nodiscard]] std::uint32_t block_count() const { return block_count_; }
    // A block's items, copied out of the level when first asked for.
    [[nodiscard]] const ItemBlock& block(std::uint32_t i) {
        if (stamps_[i] == kListed) place(i);
        return blocks_[i];
    }
    // Whether the block was ever evaluated.
    [[nodiscard]] bool evaluated(std::uint32_t i) const { return stamps_[i] > kPlaced; }
    [[nodiscard]] EvalBlock& evaluation(std::uint32_t i) { return evaluations_[i]; }
    [[nodiscard]] const EvalBlock& evaluation(std::uint32_t i) const { return evaluations_[i]; }
    // Lower bound of a block's clearance plus the path length at which it was found.
    [[nodiscard]] double& key(std::uint32_t i) { return keys_[i]; }
    [[nodiscard]] double key(std::uint32_t i) const { return keys_[i]; }
    // Where the evaluation was made (the solver's stamp, above kAtCentre).
    static constexpr std::uint32_t kListed = 0, kPlaced = 1, kAtCentre = 2;
    [[nodiscard]] std::uint32_t& stamp(std::uint32_t i) { return stamps_[i]; }
    // Lower bound of the tool's clearance at x, as far as the gathers know.
    [[nodiscard]] double clearance_bound(const Vec3& x) const;
    [[nodiscard]] std::size_t bytes() const;

private:
    void place(std::uint32_t i);
    bool gather_node(std::uint32_t node, std::span<const SolverBall> balls, double reach, TickCounters& counters);
    bool gather_ball(const SolverBall& ball, std::uint32_t index, double reach, TickCounters& counters);
    [[nodiscard]] double empty_within(const Vec3& centre, double inner, double outer, TickCounters& counters) const;
    template <class Use>
    void for_cells(const Vec3& centre, double range, TickCounters& counters, Use&& use) const;
    // How far a ball, or all balls below a node, were from the surface.
    struct Safe {
        double clear = 0.0;     // clear by this much ...
        double odometer = 0.0;  // ... when the path length was this
    };

    const ActiveLevel* level_ = nullptr;
    const Kernels* kernels_ = nullptr;
    std::vector<ItemBlock> blocks_;
    std::vector<EvalBlock> evaluations_;
    std::vector<double> keys_;
    std::vector<std::uint32_t> stamps_;
    struct Source {
        std::uint32_t block, ball;
    };
    std::vector<Source> sources_;
    std::span<const SolverBall> solver_balls_;
    const ToolTree* tree_ = nullptr;
    std::vector<Safe> balls_, nodes_;
    std::uint32_t block_count_ = 0;
    Vec3 centre_;
    double reach_ = 0.0, odometer_ = 0.0;
    bool valid_ = false;

    [[nodiscard]] double still_clear(const Safe& s) const { return s.clear - (odometer_ - s.odometer); }
};

}  // namespace hapticlod
