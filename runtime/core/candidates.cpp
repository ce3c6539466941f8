#include "core/candidates.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

namespace hapticlod {
namespace {

// Bits of a brick's cells with x, y, z in [lo, hi] (0..3 each).
std::uint64_t cells_in_range(const int lo[3], const int hi[3]) {
    const auto line = [](int a, int b) { return ((2u << b) - 1u) & ~((1u << a) - 1u); };
    const std::uint64_t row = line(lo[0], hi[0]);
    std::uint64_t plane = 0;
    for (int y = lo[1]; y <= hi[1]; ++y) plane |= row << (4 * y);
    std::uint64_t all = 0;
    for (int z = lo[2]; z <= hi[2]; ++z) all |= plane << (16 * z);
    return all;
}

double axis_gap(double p, double lo, double hi) { return p < lo ? lo - p : (p > hi ? p - hi : 0.0); }

}  // namespace

void Candidates::allocate(const ToolTree& tree, std::size_t balls) {
    tree_ = &tree;
    blocks_.resize(kMaxBlocks);
    evaluations_.resize(kMaxBlocks);
    keys_.resize(kMaxBlocks);
    stamps_.resize(kMaxBlocks);
    sources_.resize(kMaxBlocks);
    balls_.resize(balls);
    nodes_.resize(tree.nodes().size());
    forget();
}

void Candidates::bind(const ActiveLevel& level, const Kernels& kernels) {
    level_ = &level;
    kernels_ = &kernels;
    forget();
}

void Candidates::forget() {
    std::fill(balls_.begin(), balls_.end(), Safe{});
    std::fill(nodes_.begin(), nodes_.end(), Safe{});
    odometer_ = 0.0;
    valid_ = false;
}

std::size_t Candidates::bytes() const {
    return blocks_.size() *
               (sizeof(ItemBlock) + sizeof(EvalBlock) + sizeof(double) + sizeof(std::uint32_t) + sizeof(Source)) +
           (balls_.size() + nodes_.size()) * sizeof(Safe);
}

double Candidates::clearance_bound(const Vec3& x) const {
    double least = still_clear(nodes_[tree_->root()]) - norm(x - centre_);
    if (block_count_ > 0) {
        least = std::numeric_limits<double>::infinity();
        for (std::uint32_t i = 0; i < block_count_; ++i) least = std::min(least, keys_[i]);
        least = std::min(least, reach_) - norm(x - centre_);
    }
    return std::max(least, 0.0);
}

// Calls use(brick, bit, gap2) for every occupied cell within `range` of the centre, until it returns false.
template <class Use>
void Candidates::for_cells(const Vec3& centre, double range, TickCounters& counters, Use&& use) const {
    const LevelView& level = level_->view;
    const double h = level.hash->cell_mm, loose = double{level.hash->loose_mm};
    const double at[3] = {centre.x, centre.y, centre.z};
    std::int32_t lo[3], hi[3], brick_lo[3], brick_hi[3];
    for (int k = 0; k < 3; ++k) {
        const double first = 4.0 * level.hash->brick_min[k], last = 4.0 * level.hash->brick_max[k] + 3.0;
        const double from = (at[k] - range - loose) / h, to = (at[k] + range + loose) / h;
        if (!(to >= first && from <= last + 1.0)) return;
        lo[k] = static_cast<std::int32_t>(std::floor(std::max(from, first)));
        hi[k] = static_cast<std::int32_t>(std::floor(std::min(to, last)));
        brick_lo[k] = lo[k] >> 2, brick_hi[k] = hi[k] >> 2;
    }
    counters.cells += level_->occupancy.for_bricks(level, brick_lo, brick_hi, [&](const Brick& brick) {
        const std::int32_t base[3] = {brick.x * 4, brick.y * 4, brick.z * 4};
        int from[3], to[3];
        for (int k = 0; k < 3; ++k) from[k] = std::max(lo[k] - base[k], 0), to[k] = std::min(hi[k] - base[k], 3);
        for (std::uint64_t bits = brick.mask & cells_in_range(from, to); bits != 0; bits &= bits - 1) {
            const int bit = std::countr_zero(bits);
            const std::int32_t cell[3] = {base[0] + (bit & 3), base[1] + (bit >> 2 & 3), base[2] + (bit >> 4)};
            double gap2 = 0.0;
            for (int k = 0; k < 3; ++k) {
                const double gap = axis_gap(at[k], cell[k] * h - loose, (cell[k] + 1) * h + loose);
                gap2 += gap * gap;
            }
            if (gap2 <= range * range && !use(brick, bit, gap2)) return false;
        }
        return true;
    });
}

// Distance to the nearest occupied cell farther than inner, at most outer. 0 where one is nearer than inner and
// `inner` is negative.
double Candidates::empty_within(const Vec3& centre, double inner, double outer, TickCounters& counters) const {
    double nearest2 = outer * outer;
    for_cells(centre, outer, counters, [&](const Brick&, int, double gap2) {
        if (inner < 0.0 || gap2 > inner * inner) nearest2 = std::min(nearest2, gap2);
        return true;
    });
    return std::sqrt(nearest2);
}

void Candidates::place(std::uint32_t i) {
    const SolverBall& ball = solver_balls_[sources_[i].ball];
    const Vec3 centre = centre_ + ball.offset;
    const double at[3] = {centre.x, centre.y, centre.z};
    float shift[3], residual[3];
    for (int k = 0; k < 3; ++k) {
        shift[k] = static_cast<float>(at[k]);
        residual[k] = static_cast<float>(at[k] - double{shift[k]});
    }
    kernels_->place(level_->view.blocks[sources_[i].block], shift, residual, static_cast<float>(ball.kept), blocks_[i]);
    std::fill_n(blocks_[i].ball, 8, sources_[i].ball);
    stamps_[i] = kPlaced;
}

bool Candidates::gather_ball(const SolverBall& ball, std::uint32_t index, double reach, TickCounters& counters) {
    const LevelView& level = level_->view;
    const Vec3 centre = centre_ + ball.offset;
    const float at[3] = {static_cast<float>(centre.x), static_cast<float>(centre.y), static_cast<float>(centre.z)};
    ++counters.balls;
    const std::uint32_t before = block_count_;
    const double inner = (ball.kept + reach) * (1.0 + 1e-6);
    const float within = static_cast<float>(inner) * 1.00001f;
    double least = std::numeric_limits<double>::infinity();
    bool complete = true;
    for_cells(centre, inner, counters, [&](const Brick& brick, int bit, double) {
        ++counters.cells;
        const std::uint64_t below = brick.mask & ((std::uint64_t{1} << bit) - 1);
        const std::uint32_t cell = brick.first_cell + static_cast<std::uint32_t>(std::popcount(below));
        counters.triangles += 8 * (level.cells[cell + 1] - level.cells[cell]);
        for (std::uint32_t b = level.cells[cell]; b < level.cells[cell + 1]; ++b) {
            const Sphere& sphere = level_->spheres[b];
            const float dx = sphere.x - at[0], dy = sphere.y - at[1], dz = sphere.z - at[2];
            const float distance = std::sqrt(dx * dx + dy * dy + dz * dz) - sphere.radius;
            if (distance > within) {
                least = std::min(least, double{distance} - ball.kept);
                continue;
            }
            if (block_count_ == kMaxBlocks) return complete = false;
            sources_[block_count_] = {b, index};
            keys_[block_count_] = double{distance} - ball.kept;
            stamps_[block_count_] = kListed;
            // A sphere much larger than the reach says little: look now, and mostly be rid of the block.
            if (double{sphere.radius} > reach) {
                place(block_count_);
                const float here[3] = {0.0f, 0.0f, 0.0f};
                const double clearance{kernels_->eval(blocks_[block_count_], here, evaluations_[block_count_])};
                counters.tests += 8;
                least = std::min(least, clearance);
                if (clearance > reach) continue;
                keys_[block_count_] = clearance;
                stamps_[block_count_] = kAtCentre;
            }
            ++block_count_;
        }
        return true;
    });
    if (!complete) return false;
    if (block_count_ > before) {
        balls_[index] = {0.0, odometer_};
        return true;
    }
    // Nothing within reach: how far is the nearest cell beyond? Until the tool has moved that far, leave the ball be.
    const double outer = inner + std::max(2.0 * level.hash->cell_mm, 3.0 * reach);
    const double beyond = empty_within(centre, inner, outer, counters) - ball.kept;
    balls_[index] = {std::max(std::min(beyond, least), reach), odometer_};
    return true;
}

bool Candidates::gather_node(std::uint32_t index, std::span<const SolverBall> balls, double reach,
                             TickCounters& counters) {
    const ToolTree::Node& node = tree_->nodes()[index];
    Safe& safe = nodes_[index];
    if (node.least_ball >= balls.size() || still_clear(safe) > reach) return true;
    // A node that was near a moment ago is near now: look at its children at once.
    if (node.count > 1 && safe.odometer < odometer_ - 4.0 * reach) {
        ++counters.balls;
        const double outer = node.radius + reach + std::max(2.0 * level_->view.hash->cell_mm, 3.0 * reach);
        const double clear = empty_within(centre_ + node.offset, -1.0, outer, counters) - node.radius;
        if (clear > reach) {
            safe = {clear, odometer_};
            return true;
        }
    }
    double clear = std::numeric_limits<double>::infinity();
    for (std::uint32_t k = node.first; k < node.first + node.count; ++k) {
        const std::uint32_t child = node.above_balls ? tree_->ball(k) : k;
        if (node.above_balls) {
            if (child >= balls.size()) continue;
            if (still_clear(balls_[child]) <= reach && !gather_ball(balls[child], child, reach, counters)) return false;
            clear = std::min(clear, still_clear(balls_[child]));
        } else {
            if (!gather_node(child, balls, reach, counters)) return false;
            if (tree_->nodes()[child].least_ball < balls.size()) clear = std::min(clear, still_clear(nodes_[child]));
        }
    }
    safe = {clear, odometer_};
    return true;
}

double Candidates::gather(const Vec3& centre, double reach, std::span<const SolverBall> balls, TickCounters& counters) {
    solver_balls_ = balls;
    odometer_ += norm(centre - centre_);
    centre_ = centre;
    for (int attempt = 0;; ++attempt) {
        block_count_ = 0;
        const bool complete = gather_node(tree_->root(), balls, reach, counters);
        valid_ = true;
        // With nothing near, the candidates (none) stay complete for as long as the tool is clear.
        reach_ = block_count_ == 0 && complete ? std::max(reach, still_clear(nodes_[tree_->root()])) : reach;
        if (complete || attempt == 12) return complete ? reach_ : 0.0;
        // Too many triangles near: take a shorter reach. Safe distances found so far stay true.
        reach *= 0.5;
    }
}

}  // namespace hapticlod
