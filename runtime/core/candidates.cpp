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

void Candidates::allocate(std::size_t balls) {
    blocks_.resize(kMaxBlocks);
    evaluations_.resize(kMaxBlocks);
    keys_.resize(kMaxBlocks);
    stamps_.resize(kMaxBlocks);
    balls_.resize(balls);
    forget();
}

void Candidates::bind(const LevelView& level, const Kernels& kernels) {
    level_ = level;
    kernels_ = &kernels;
    forget();
}

void Candidates::forget() {
    for (BallState& b : balls_) b = {};
    odometer_ = 0.0;
    valid_ = false;
}

std::size_t Candidates::bytes() const {
    return blocks_.size() * (sizeof(ItemBlock) + sizeof(EvalBlock) + sizeof(double) + sizeof(std::uint32_t)) +
           balls_.size() * sizeof(BallState);
}

double Candidates::clearance_bound(const Vec3& x, std::size_t balls) const {
    double least = std::numeric_limits<double>::infinity();
    for (std::uint32_t i = 0; i < block_count_; ++i) least = std::min(least, keys_[i]);
    const double moved = norm(x - centre_);
    for (std::size_t i = 0; i < balls; ++i) {
        const double safe = balls_[i].safe - (odometer_ - balls_[i].odometer) - moved;
        if (balls_[i].safe > 0.0) least = std::min(least, safe);
    }
    return std::max(least, 0.0);
}

bool Candidates::append(const TriBlock& block, std::uint32_t lane, const Vec3& ball_centre, const SolverBall& ball,
                        std::uint32_t index) {
    const std::uint32_t at = item_count_ / 8, to = item_count_ % 8;
    if (at >= kMaxBlocks) return false;
    ItemBlock& out = blocks_[at];
    const double shift[3] = {ball_centre.x, ball_centre.y, ball_centre.z};
    for (int row = 0; row < 9; ++row) out.v[row][to] = static_cast<float>(double{block.v[row][lane]} - shift[row % 3]);
    out.radius[to] = static_cast<float>(ball.kept);
    out.triangle[to] = block.id[lane];
    out.ball[to] = index;
    ++item_count_;
    return true;
}

void Candidates::finish() {
    // Unused lanes repeat the last item: they change neither the least clearance nor any decision.
    if (item_count_ % 8 != 0) {
        ItemBlock& out = blocks_[item_count_ / 8];
        const std::uint32_t last = item_count_ % 8 - 1;
        for (std::uint32_t lane = last + 1; lane < 8; ++lane) {
            for (auto& row : out.v) row[lane] = row[last];
            out.radius[lane] = out.radius[last];
            out.triangle[lane] = out.triangle[last];
            out.ball[lane] = out.ball[last];
        }
    }
    block_count_ = (item_count_ + 7) / 8;
    for (std::uint32_t i = 0; i < block_count_; ++i) {
        keys_[i] = -std::numeric_limits<double>::infinity();
        stamps_[i] = 0;
    }
}

bool Candidates::gather_ball(const SolverBall& ball, std::uint32_t index, double reach, TickCounters& counters) {
    const HashHeader& hash = *level_.hash;
    const double h = hash.cell_mm;
    const Vec3 centre = centre_ + ball.offset;
    const double inner = ball.kept + reach;                       // triangles within this distance become items
    const double outer = inner + std::max(2.0 * h, 3.0 * reach);  // emptiness is known up to this distance
    const double at[3] = {centre.x, centre.y, centre.z};
    std::int32_t lo[3], hi[3];
    for (int k = 0; k < 3; ++k) {
        // The model's bounds first: far away, the interval is empty and casting stays in range.
        const double brick_lo = 4.0 * hash.brick_min[k] * h, brick_hi = 4.0 * (hash.brick_max[k] + 1.0) * h;
        const double from = std::max(at[k] - outer, brick_lo), to = std::min(at[k] + outer, brick_hi - 0.5 * h);
        if (from > to) {
            balls_[index] = {std::max(outer, axis_gap(at[k], brick_lo, brick_hi)) - ball.kept, odometer_};
            return true;
        }
        lo[k] = static_cast<std::int32_t>(std::floor(from / h));
        hi[k] = static_cast<std::int32_t>(std::floor(to / h));
    }
    const float p[3] = {static_cast<float>(at[0]), static_cast<float>(at[1]), static_cast<float>(at[2])};
    const double inner_margin = inner + 1e-6 * (inner + std::abs(at[0]) + std::abs(at[1]) + std::abs(at[2]));
    const float inner2 = static_cast<float>(inner_margin * inner_margin);
    double nearest_cell2 = outer * outer;
    const std::uint32_t before = item_count_;
    bool near_cells = false;

    const auto visit = [&](const Brick& brick) {
        const std::int32_t base[3] = {brick.x * 4, brick.y * 4, brick.z * 4};
        int from[3], to[3];
        for (int k = 0; k < 3; ++k) {
            from[k] = std::max(lo[k] - base[k], 0);
            to[k] = std::min(hi[k] - base[k], 3);
            if (from[k] > to[k]) return true;
        }
        for (std::uint64_t bits = brick.mask & cells_in_range(from, to); bits != 0; bits &= bits - 1) {
            const int bit = std::countr_zero(bits);
            const std::int32_t cell[3] = {base[0] + (bit & 3), base[1] + (bit >> 2 & 3), base[2] + (bit >> 4)};
            double gap2 = 0.0;
            for (int k = 0; k < 3; ++k) {
                const double gap = axis_gap(at[k], cell[k] * h, (cell[k] + 1) * h);
                gap2 += gap * gap;
            }
            if (gap2 > inner_margin * inner_margin) {
                nearest_cell2 = std::min(nearest_cell2, gap2);
                continue;
            }
            ++counters.cells;
            near_cells = true;
            const std::uint64_t below = brick.mask & ((std::uint64_t{1} << bit) - 1);
            const std::uint32_t index_of_cell = brick.first_cell + static_cast<std::uint32_t>(std::popcount(below));
            for (std::uint32_t b = level_.cells[index_of_cell]; b < level_.cells[index_of_cell + 1]; ++b) {
                const TriBlock& block = level_.blocks[b];
                float distance2[8], closest[3][8];
                kernels_->closest(block, p, distance2, closest);
                counters.triangles += 8;
                for (std::uint32_t lane = 0; lane < 8; ++lane) {
                    if (distance2[lane] > inner2 || block.id[lane] == kNoNeighbour) continue;
                    // A triangle listed in several cells is taken from the one that holds its closest point.
                    bool here = true;
                    for (int k = 0; k < 3; ++k)
                        here = here && static_cast<std::int32_t>(std::floor(double{closest[k][lane]} / h)) == cell[k];
                    if (here && !append(block, lane, centre, ball, index)) return false;
                }
            }
        }
        return true;
    };

    const std::int32_t first[3] = {lo[0] >> 2, lo[1] >> 2, lo[2] >> 2}, last[3] = {hi[0] >> 2, hi[1] >> 2, hi[2] >> 2};
    const double volume =
        double(last[0] - first[0] + 1) * double(last[1] - first[1] + 1) * double(last[2] - first[2] + 1);
    if (volume > hash.brick_count) {
        for (const Brick& brick : level_.bricks)
            if (!visit(brick)) return false;
        counters.cells += hash.brick_count;
    } else {
        for (std::int32_t z = first[2]; z <= last[2]; ++z)
            for (std::int32_t y = first[1]; y <= last[1]; ++y)
                for (std::int32_t x = first[0]; x <= last[0]; ++x) {
                    ++counters.cells;
                    const Brick* brick = find_brick(level_, x, y, z);
                    if (brick != nullptr && !visit(*brick)) return false;
                }
    }
    if (item_count_ > before) {
        balls_[index] = {0.0, odometer_};
    } else {
        // A near cell whose triangles are all farther than the reach proves no more than the reach.
        balls_[index] = {near_cells ? reach : std::sqrt(nearest_cell2) - ball.kept, odometer_};
    }
    return true;
}

double Candidates::gather(const Vec3& centre, double reach, std::span<const SolverBall> balls, TickCounters& counters) {
    odometer_ += norm(centre - centre_);
    centre_ = centre;
    for (int attempt = 0;; ++attempt) {
        item_count_ = 0;
        bool complete = true;
        for (std::uint32_t i = 0; i < balls.size() && complete; ++i) {
            const double safe = balls_[i].safe - (odometer_ - balls_[i].odometer);
            if (safe > reach) continue;
            ++counters.balls;
            complete = gather_ball(balls[i], i, reach, counters);
        }
        finish();
        reach_ = reach;
        valid_ = true;
        if (complete || attempt == 12) return complete ? reach : 0.0;
        // Too many triangles near: take a shorter reach, and all safe distances found so far stay true.
        reach *= 0.5;
    }
}

}  // namespace hapticlod
