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

void Candidates::bind(const ActiveLevel& level, const Kernels& kernels) {
    level_ = &level;
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

bool Candidates::gather_ball(const SolverBall& ball, std::uint32_t index, double reach, TickCounters& counters) {
    const LevelView& level = level_->view;
    const double h = level.hash->cell_mm, loose = double{level.hash->loose_mm};
    const Vec3 centre = centre_ + ball.offset;
    const double at[3] = {centre.x, centre.y, centre.z};
    float shift[3], residual[3];
    for (int k = 0; k < 3; ++k) {
        shift[k] = static_cast<float>(at[k]);
        residual[k] = static_cast<float>(at[k] - double{shift[k]});
    }
    const float radius = static_cast<float>(ball.kept);
    const std::uint32_t before = block_count_;

    // Calls use(brick, bit, gap2) for every occupied cell within `range` of the centre.
    const auto for_cells = [&](double range, auto&& use) {
        std::int32_t lo[3], hi[3], brick_lo[3], brick_hi[3];
        for (int k = 0; k < 3; ++k) {
            const double first = 4.0 * level.hash->brick_min[k], last = 4.0 * level.hash->brick_max[k] + 3.0;
            const double from = (at[k] - range - loose) / h, to = (at[k] + range + loose) / h;
            if (to < first || from > last + 1.0) return;
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
    };

    const double inner = ball.kept + reach + 1e-6 * (ball.kept + reach);
    const float within = static_cast<float>(inner) * 1.00001f;
    double least = std::numeric_limits<double>::infinity();
    bool complete = true;
    for_cells(inner, [&](const Brick& brick, int bit, double) {
        ++counters.cells;
        const std::uint64_t below = brick.mask & ((std::uint64_t{1} << bit) - 1);
        const std::uint32_t cell = brick.first_cell + static_cast<std::uint32_t>(std::popcount(below));
        for (std::uint32_t b = level.cells[cell]; b < level.cells[cell + 1]; ++b) {
            const Sphere& sphere = level_->spheres[b];
            const float dx = sphere.x - shift[0], dy = sphere.y - shift[1], dz = sphere.z - shift[2];
            const float far = sphere.radius + within;
            if (dx * dx + dy * dy + dz * dz > far * far) continue;
            if (block_count_ == kMaxBlocks) return complete = false;
            ItemBlock& block = blocks_[block_count_];
            const float clearance =
                kernels_->gather(level.blocks[b], shift, residual, radius, block, evaluations_[block_count_]);
            counters.triangles += 8;
            least = std::min(least, double{clearance});
            if (double{clearance} > reach) continue;
            std::fill_n(block.ball, 8, index);
            keys_[block_count_] = double{clearance};
            stamps_[block_count_] = stamp_;
            ++block_count_;
        }
        return true;
    });
    if (!complete) return false;
    if (block_count_ > before) {
        balls_[index] = {0.0, odometer_};
        return true;
    }
    // Nothing within reach: how far is the nearest occupied cell? Until the tool has moved that far, leave the ball be.
    const double outer = inner + std::max(2.0 * h, 3.0 * reach);
    double nearest2 = outer * outer;
    for_cells(outer, [&](const Brick&, int, double gap2) {
        if (gap2 > inner * inner) nearest2 = std::min(nearest2, gap2);
        return true;
    });
    balls_[index] = {std::min(std::sqrt(nearest2) - ball.kept, least), odometer_};
    return true;
}

double Candidates::gather(const Vec3& centre, double reach, std::span<const SolverBall> balls, TickCounters& counters,
                          std::uint32_t stamp) {
    stamp_ = stamp;
    odometer_ += norm(centre - centre_);
    centre_ = centre;
    for (int attempt = 0;; ++attempt) {
        block_count_ = 0;
        bool complete = true;
        double clear = std::numeric_limits<double>::infinity();
        for (std::uint32_t i = 0; i < balls.size() && complete; ++i) {
            const auto safe = [&] { return balls_[i].safe - (odometer_ - balls_[i].odometer); };
            if (safe() <= reach) {
                ++counters.balls;
                complete = gather_ball(balls[i], i, reach, counters);
            }
            clear = std::min(clear, safe());
        }
        valid_ = true;
        // With nothing near, the candidates (none) stay complete for as long as the tool is clear.
        reach_ = block_count_ == 0 && complete ? std::max(reach, clear) : reach;
        if (complete || attempt == 12) return complete ? reach_ : 0.0;
        // Too many triangles near: take a shorter reach. Safe distances found so far stay true.
        reach *= 0.5;
    }
}

}  // namespace hapticlod
