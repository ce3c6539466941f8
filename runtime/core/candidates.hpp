// The triangles near the tool, gathered once and used for as many ticks as they stay sufficient.
//
// A ball of the tool at offset o with radius r touches triangle T where the tool's reference point is within r of
// T - o. So every (ball, triangle) pair becomes one item: a shifted triangle with a radius, and the whole tool one
// point. Items are complete as long as no ball has moved further than `reach` from where it was: a ball that was clear
// by c then cannot have come within c - s after it moved s. Turning the tool moves balls too, and only shifts items.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/kernels.hpp"
#include "core/scene.hpp"
#include "core/tool_tree.hpp"
#include "core/triangle.hpp"
#include "core/vec.hpp"

namespace hapticlod {

struct TickCounters {
    std::uint32_t cells = 0, triangles = 0, tests = 0, iterations = 0, balls = 0, mapping_cells = 0;
    std::uint32_t errors = 0;

    // What was done so far, in triangle distances.
    [[nodiscard]] double work() const { return tests + 0.25 * triangles + 0.5 * cells; }
};

class Candidates {
public:
#ifdef HAPTICLOD_FEW_BLOCKS  // fuzzing: a renderer made a thousand times a second, its scratch full within reach
    static constexpr std::uint32_t kMaxBlocks = 256;
#else
    static constexpr std::uint32_t kMaxBlocks = 8192;  // (ball, block) pairs: 65536 items
#endif

    // The tree must outlive this; its offsets may turn.
    void allocate(const ToolTree& tree, std::size_t balls);
    void bind(const SceneLevel& level, const Kernels& kernels);

    // Everything that a ball could touch while it stays within `reach` of where it is with the reference at centre.
    // Items beyond the reach and repeated ones may be among it. Blocks are only listed, with a lower bound of their
    // clearance: most are never looked at. What is known of pairs that were listed before is kept; `path` is the length
    // moved since the last gather, `off` how far the reference point is from the centre. Returns the reach that could
    // be granted (less where the scratch is too small).
    double gather(const Vec3& centre, double reach, double path, double off, std::span<const SolverBall> balls,
                  TickCounters& counters);

    // Asks memory for a pair's triangles, which will be looked at soon.
    void fetch(std::uint32_t i) const {
        const char* line = reinterpret_cast<const char*>(&triangles(i));
        for (std::size_t k = 0; k < sizeof(TriBlock); k += 64) __builtin_prefetch(line + k);
    }

    // The blocks of all cells within range of the way from -> from + along, unlisted: for one ball that needs few of
    // them, once.
    struct Around {
        static constexpr std::uint32_t kMost = 64;
        alignas(32) std::array<BlockBound, kMost> bounds;
        std::array<const TriBlock*, kMost> blocks;
        std::array<std::uint16_t, kMost> part;
        std::uint32_t count = 0;
    };
    // False: there are more than fit.
    [[nodiscard]] bool around(const Vec3& from, const Vec3& along, double range, Around& out, TickCounters& counters);

    void invalidate() { valid_ = false; }
    // Forget the safe distances too: the level or the tool changed.
    void forget();
    // The tool's balls moved by up to `distance` relative to the reference point.
    void rotated(double distance) { odometer_ += distance, turned_ += distance; }

    [[nodiscard]] const SceneLevel& level() const { return *level_; }
    [[nodiscard]] bool valid() const { return valid_; }
    [[nodiscard]] const Vec3& centre() const { return centre_; }
    // What is left for the reference point to move.
    [[nodiscard]] double reach() const { return reach_ - turned_; }
    [[nodiscard]] std::uint32_t block_count() const { return block_count_; }
    [[nodiscard]] std::uint32_t ball(std::uint32_t i) const { return pairs_[i].whose & 0xffffu; }
    [[nodiscard]] std::uint16_t part(std::uint32_t i) const {
        return static_cast<std::uint16_t>(pairs_[i].whose >> 16);
    }
    // Lower bound of the pair's clearance with the reference point at x (relative to centre()), without evaluating it.
    [[nodiscard]] double bound(std::uint32_t i, const Vec3& x) const;
    // Whether the move from -> from + step of the reference point (relative to centre()) keeps the ball by the margin
    // clear of the block's bounding ball: for that nothing has to be evaluated.
    [[nodiscard]] bool passes_by(std::uint32_t i, const Vec3& from, const Vec3& step, double margin) const;
    [[nodiscard]] std::uint32_t triangle_id(std::uint32_t i, std::uint32_t lane) const;
    // As an obstacle of the reference point, relative to centre().
    [[nodiscard]] Triangle triangle(std::uint32_t i, std::uint32_t lane) const {
        const auto& v = triangles(i).v;
        const Vec3 at = centre_ + solver_balls_[ball(i)].offset;
        return {Vec3{v[0][lane], v[1][lane], v[2][lane]} - at, Vec3{v[3][lane], v[4][lane], v[5][lane]} - at,
                Vec3{v[6][lane], v[7][lane], v[8][lane]} - at};
    }
    [[nodiscard]] std::uint32_t block(std::uint32_t i) const { return pairs_[i].block; }
    [[nodiscard]] const TriBlock& triangles(std::uint32_t i) const { return surface(i).view.blocks[pairs_[i].block]; }
    // Of every pair's block, in the order of the list. Only where one ball is used.
    [[nodiscard]] const BlockBound* listed_bounds() const { return listed_bounds_.data(); }
    // Looks at a pair with the reference point at x, and keeps what it sees. Returns the least clearance.
    double evaluate(std::uint32_t i, const Vec3& x, std::uint32_t stamp);
    [[nodiscard]] bool evaluated(std::uint32_t i) const { return pairs_[i].stamp != kListed; }
    [[nodiscard]] const EvalBlock& evaluation(std::uint32_t i) const { return evaluations_[pairs_[i].slot]; }
    // Lower bound of a pair's clearance plus the path length at which it was found.
    [[nodiscard]] double& key(std::uint32_t i) { return keys_[i]; }
    [[nodiscard]] double key(std::uint32_t i) const { return keys_[i]; }
    // Which evaluate() was the last.
    [[nodiscard]] std::uint32_t stamp(std::uint32_t i) const { return pairs_[i].stamp; }
    static constexpr std::uint32_t kListed = 0;
    // Lower bound of the tool's clearance at x after a path of that length, as far as the gathers know.
    [[nodiscard]] double clearance_bound(const Vec3& x, double path) const;
    [[nodiscard]] std::size_t bytes() const;

private:
    struct Pair {
        std::uint32_t block, whose, slot, stamp;  // whose: the part in the upper half, the ball in the lower
    };
    struct Known {  // of a pair of the last gather
        std::uint32_t block, whose, index, epoch;
    };
    static constexpr std::uint32_t kTable = 4 * kMaxBlocks;

    [[nodiscard]] const ActiveLevel& surface(std::uint32_t i) const { return *level_->surfaces[part(i)]; }
    void look_at(std::uint32_t part) { part_ = part, surface_ = level_->surfaces[part]; }
    void choose_parts(const Vec3& centre, double reach);
    bool gather_node(std::uint32_t node, double reach, TickCounters& counters);
    bool gather_balls(std::uint32_t node, double reach, TickCounters& counters);
    bool gather_one(std::uint32_t place, double reach, TickCounters& counters);
    void list(std::uint32_t block, std::uint32_t whose, double bound);
    void remember();
    void release();
    [[nodiscard]] Known& known(std::uint32_t block, std::uint32_t whose);
    [[nodiscard]] double empty_within(const Vec3& centre, double outer, TickCounters& counters);
    template <class Use>
    void for_cells(const Vec3& centre, double range, TickCounters& counters, Use&& use) const;
    template <class Use, class Done>
    [[nodiscard]] bool for_blocks(const Vec3& centre, double range, TickCounters& counters, Use&& use, Done&& done);

    const SceneLevel* level_ = nullptr;
    const Kernels* kernels_ = nullptr;
    std::vector<Pair> pairs_, last_pairs_;
    std::vector<double> keys_, last_keys_;
    std::vector<BlockBound> listed_bounds_;
    std::vector<EvalBlock> evaluations_;
    std::vector<std::uint32_t> free_;  // slots of evaluations_ that no pair holds
    std::vector<Known> table_;         // open addressing; entries of other epochs are empty
    std::span<const SolverBall> solver_balls_;
    const ToolTree* tree_ = nullptr;
    double tool_mm_ = 0.0;  // no kept ball reaches further from the reference point, however the tool is turned
    std::array<std::uint32_t, kMaxParts> near_parts_{};  // that this gather looks at
    std::uint32_t near_count_ = 0;
    std::uint32_t part_ = 0;                // whose surface is being looked at
    const ActiveLevel* surface_ = nullptr;  // while it is listed
    // A ball (in the tree's order), or all balls below a node, stay clear until the odometer says this.
    std::vector<double> balls_clear_until_, nodes_clear_until_, nodes_looked_at_;
    std::uint32_t block_count_ = 0, last_count_ = 0, evaluated_ = 0, last_evaluated_ = 0, epoch_ = 0, table_mask_ = 0;
    Vec3 centre_;
    double reach_ = 0.0, turned_ = 0.0, odometer_ = 0.0, last_path_ = 0.0, off_ = 0.0, near_ = 0.0;
    bool valid_ = false;
};

}  // namespace hapticlod
