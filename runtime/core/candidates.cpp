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
    pairs_.resize(kMaxBlocks);
    last_pairs_.resize(kMaxBlocks);
    keys_.resize(kMaxBlocks);
    last_keys_.resize(kMaxBlocks);
    listed_bounds_.resize(kMaxBlocks + 7);  // kernels read eight at a time
    evaluations_.resize(kMaxBlocks);
    free_.resize(kMaxBlocks);
    table_.assign(kTable, {});
    epoch_ = 0;
    balls_clear_until_.resize(balls);
    nodes_clear_until_.resize(tree.nodes().size());
    nodes_looked_at_.resize(tree.nodes().size());
    tool_mm_ = 0.0;
    for (const ToolTree::Node& node : tree.nodes()) tool_mm_ = std::max(tool_mm_, norm(node.centre) + node.radius);
    forget();
}

void Candidates::bind(const SceneLevel& level, const Kernels& kernels) {
    level_ = &level;
    kernels_ = &kernels;
    near_parts_[0] = level.visible[0], near_count_ = 1;  // of one, there is nothing to choose
    look_at(near_parts_[0]);
    forget();
}

void Candidates::forget() {
    std::fill(balls_clear_until_.begin(), balls_clear_until_.end(), 0.0);
    std::fill(nodes_clear_until_.begin(), nodes_clear_until_.end(), 0.0);
    std::fill(nodes_looked_at_.begin(), nodes_looked_at_.end(), 0.0);
    for (std::uint32_t i = 0; i < kMaxBlocks; ++i) free_[i] = kMaxBlocks - 1 - i;
    odometer_ = 0.0;
    block_count_ = 0;
    evaluated_ = 0;
    valid_ = false;
}

std::size_t Candidates::bytes() const {
    return kMaxBlocks * (2 * sizeof(Pair) + 2 * sizeof(double) + sizeof(EvalBlock) + sizeof(std::uint32_t)) +
           listed_bounds_.size() * sizeof(BlockBound) + kTable * sizeof(Known) +
           (balls_clear_until_.size() + nodes_clear_until_.size() + nodes_looked_at_.size()) * sizeof(double);
}

std::uint32_t Candidates::triangle_id(std::uint32_t i, std::uint32_t lane) const {
    const TriBlock& block = triangles(i);
    return block.id[lane] == kNoNeighbour ? block.id[0] : block.id[lane];
}

double Candidates::bound(std::uint32_t i, const Vec3& x) const {
    const BlockBound& b = surface(i).bounds[pairs_[i].block];
    const SolverBall& ball = solver_balls_[this->ball(i)];
    const Vec3 to = Vec3{b.x, b.y, b.z} - (centre_ + x + ball.offset);
    const double h = std::abs(dot(to, Vec3{b.nx, b.ny, b.nz})), to2 = norm2(to) * (1.0 - 1e-6);
    const double above = std::max(h - double{b.half}, 0.0);
    const double aside = std::max(std::sqrt(std::max(to2 - h * h, 0.0)) - double{b.radius}, 0.0);
    return std::sqrt(above * above + aside * aside) * (1.0 - 1e-6) - ball.kept;
}

bool Candidates::passes_by(std::uint32_t i, const Vec3& from, const Vec3& step, double margin) const {
    const BlockBound& b = surface(i).bounds[pairs_[i].block];
    const SolverBall& ball = solver_balls_[this->ball(i)];
    const Vec3 to = Vec3{b.x, b.y, b.z} - (centre_ + from + ball.offset);
    const double length2 = norm2(step), along = dot(to, step), t = std::clamp(along, 0.0, length2);
    const double apart2 = norm2(to) * length2 - t * (2.0 * along - t);  // times length2
    const double least = double{b.radius} + ball.kept + margin;
    return apart2 > least * least * length2;
}

double Candidates::evaluate(std::uint32_t i, const Vec3& x, std::uint32_t stamp) {
    Pair& pair = pairs_[i];
    if (pair.stamp == kListed) pair.slot = free_[kMaxBlocks - ++evaluated_];
    pair.stamp = stamp;
    EvalBlock& out = evaluations_[pair.slot];
    const SolverBall& ball = solver_balls_[pair.whose & 0xffffu];
    (x + ball.offset).store(out.origin);
    float shift[3], residual[3];
    for (int k = 0; k < 3; ++k) {
        shift[k] = static_cast<float>(out.origin[k]);
        residual[k] = static_cast<float>(out.origin[k] - double{shift[k]});
    }
    return double{kernels_->eval(triangles(i), shift, residual, static_cast<float>(ball.kept), out)};
}

double Candidates::clearance_bound(const Vec3& x, double path) const {
    const double moved = norm(x - centre_);
    if (block_count_ == 0) return std::max(nodes_clear_until_[tree_->root()] - odometer_ - moved, 0.0);
    double least = std::numeric_limits<double>::infinity();
    for (std::uint32_t i = 0; i < block_count_; ++i) least = std::min(least, keys_[i] - path);
    return std::max(std::min(least, reach() - moved), 0.0);
}

// Calls use(brick, bit, gap2) for every occupied cell of the present surface within `range` of the centre, until it
// returns false.
template <class Use>
void Candidates::for_cells(const Vec3& centre, double range, TickCounters& counters, Use&& use) const {
    const LevelView& level = surface_->view;
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
    counters.cells += surface_->occupancy.for_bricks(level, brick_lo, brick_hi, [&](const Brick& brick) {
        const std::int32_t base[3] = {brick.x * 4, brick.y * 4, brick.z * 4};
        int from[3], to[3];
        double gap2_of[3][4], brick_gap2 = 0.0;
        for (int k = 0; k < 3; ++k) {
            const double gap = axis_gap(at[k], base[k] * h - loose, (base[k] + 4) * h + loose);
            brick_gap2 += gap * gap;
        }
        if (brick_gap2 > range * range) return true;
        for (int k = 0; k < 3; ++k) {
            from[k] = std::max(lo[k] - base[k], 0), to[k] = std::min(hi[k] - base[k], 3);
            for (int c = from[k]; c <= to[k]; ++c) {
                const double gap = axis_gap(at[k], (base[k] + c) * h - loose, (base[k] + c + 1) * h + loose);
                gap2_of[k][c] = gap * gap;
            }
        }
        for (std::uint64_t bits = brick.mask & cells_in_range(from, to); bits != 0; bits &= bits - 1) {
            const int bit = std::countr_zero(bits);
            const double gap2 = gap2_of[0][bit & 3] + gap2_of[1][bit >> 2 & 3] + gap2_of[2][bit >> 4];
            if (gap2 <= range * range && !use(brick, bit, gap2)) return false;
        }
        return true;
    });
}

// Distance to the nearest occupied cell, at most outer.
double Candidates::empty_within(const Vec3& centre, double outer, TickCounters& counters) {
    double nearest2 = outer * outer;
    for (std::uint32_t p = 0; p < near_count_; ++p) {
        look_at(near_parts_[p]);
        for_cells(centre, outer, counters, [&](const Brick&, int, double gap2) {
            nearest2 = std::min(nearest2, gap2);
            return nearest2 > 0.0;
        });
    }
    return std::sqrt(nearest2);
}

// The blocks of every occupied cell in range, of all parts that are near: use(first, end) per cell until it says false.
// done() after each part, while its surface is still the one looked at.
template <class Use, class Done>
bool Candidates::for_blocks(const Vec3& centre, double range, TickCounters& counters, Use&& use, Done&& done) {
    bool complete = true;
    for (std::uint32_t p = 0; p < near_count_ && complete; ++p) {
        look_at(near_parts_[p]);
        const std::uint32_t* cells = surface_->view.cells.data();
        for_cells(centre, range, counters, [&](const Brick& brick, int bit, double) {
            ++counters.cells;
            const std::uint32_t cell = cell_of(brick, bit);
            counters.triangles += 8 * (cells[cell + 1] - cells[cell]);
            return complete = use(cells[cell], cells[cell + 1]);
        });
        complete = complete && done();
    }
    return complete;
}

// The entry of a pair in the table, or the free entry where it would go.
Candidates::Known& Candidates::known(std::uint32_t block, std::uint32_t whose) {
    const std::uint64_t mixed = (std::uint64_t{block} << 12 ^ whose) * 0x9e3779b97f4a7c15u;
    for (std::uint32_t at = static_cast<std::uint32_t>(mixed >> 40) & table_mask_;; at = (at + 1) & table_mask_) {
        Known& k = table_[at];
        if (k.epoch != epoch_ || (k.block == block && k.whose == whose)) return k;
    }
}

// Puts the evaluated pairs of the last gather into the table.
void Candidates::remember() {
    // No larger than it has to be: it stays in the nearest cache.
    table_mask_ = std::bit_ceil(4 * last_evaluated_) - 1;
    if (++epoch_ == 0) {
        std::fill(table_.begin(), table_.end(), Known{});
        epoch_ = 1;
    }
    for (std::uint32_t i = 0; i < last_count_; ++i)
        if (last_pairs_[i].stamp != kListed)
            known(last_pairs_[i].block, last_pairs_[i].whose) = {last_pairs_[i].block, last_pairs_[i].whose, i, epoch_};
}

// Frees the evaluations that the present list has not taken over.
void Candidates::release() {
    for (std::uint32_t i = 0; i < last_count_; ++i)
        if (last_pairs_[i].stamp != kListed) free_[kMaxBlocks - evaluated_--] = last_pairs_[i].slot;
}

void Candidates::list(std::uint32_t block, std::uint32_t whose, double bound) {
    Pair pair{block, whose, 0, kListed};
    if (last_evaluated_ > 0) {
        const Known& k = known(block, whose);
        if (k.epoch == epoch_) {
            pair = last_pairs_[k.index];
            bound = std::max(bound, last_keys_[k.index] - last_path_ + off_);
        }
    }
    // A new pair this near will be looked at in this tick or the next: its triangles are on their way meanwhile.
    if (pair.stamp == kListed && bound < near_) {
        const char* line = reinterpret_cast<const char*>(&level_->surfaces[whose >> 16]->view.blocks[block]);
        for (std::size_t k = 0; k < sizeof(TriBlock); k += 64) __builtin_prefetch(line + k);
    }
    keys_[block_count_] = bound;
    pairs_[block_count_++] = pair;
}

// The only ball that is used against the blocks around it, eight blocks at a time.
bool Candidates::gather_one(std::uint32_t place, double reach, TickCounters& counters) {
    if (balls_clear_until_[place] - odometer_ > reach) return true;
    constexpr std::uint32_t kChunk = 32;
    const SolverBall& ball = solver_balls_[0];
    const Vec3 centre = centre_ + ball.offset;
    const float at[3] = {static_cast<float>(centre.x), static_cast<float>(centre.y), static_cast<float>(centre.z)};
    const float within = static_cast<float>(reach) * 1.00001f;
    const double outer = ball.kept + reach;
    float least = std::numeric_limits<float>::max();
    ++counters.balls;
    // Bounds of several cells together: cells hold few.
    BlockBound near_by[kChunk];
    std::uint32_t block[kChunk], waiting = 0;
    const auto look = [&] {
        float low[kChunk];
        kernels_->near_one(near_by, waiting, at, static_cast<float>(ball.kept), low);
        // Chance decides which are near: no branch.
        std::uint32_t chosen[kChunk], near = 0;
        for (std::uint32_t b = 0; b < waiting; ++b) {
            const bool is_near = low[b] <= within;
            chosen[near] = b;
            near += is_near ? 1u : 0u;
            least = std::min(least, is_near ? least : low[b]);
        }
        for (std::uint32_t k = 0; k < near; ++k) {
            if (block_count_ == kMaxBlocks) return false;
            listed_bounds_[block_count_] = near_by[chosen[k]];
            list(block[chosen[k]], part_ << 16, double{low[chosen[k]]});
        }
        waiting = 0;
        return true;
    };
    const bool complete = for_blocks(
        centre, outer, counters,
        [&](std::uint32_t b, std::uint32_t end) {
            while (b < end) {
                const std::uint32_t stop = std::min(end, b + kChunk - waiting);
                for (; b < stop; ++b, ++waiting) near_by[waiting] = surface_->bounds[b], block[waiting] = b;
                if (waiting == kChunk && !look()) return false;
            }
            return true;
        },
        [&] { return waiting == 0 || look(); });
    if (complete)
        balls_clear_until_[place] =
            odometer_ +
            (block_count_ > 0 ? 0.0 : std::max(std::min(outer - ball.kept, double{least} * 0.99999), reach));
    return complete;
}

// All cells of the box about the way, whether near it or not: a test would cost what it saves.
bool Candidates::around(const Vec3& from, const Vec3& along, double range, Around& out, TickCounters& counters) {
    if (level_->visible_count != 1) choose_parts(from + along * 0.5, 0.5 * norm(along) + range);
    const double at[3] = {from.x, from.y, from.z}, way[3] = {along.x, along.y, along.z};
    std::uint32_t n = 0;
    for (std::uint32_t p = 0; p < near_count_; ++p) {
        look_at(near_parts_[p]);
        const LevelView& level = surface_->view;
        const double inverse = 1.0 / level.hash->cell_mm, grown = range + double{level.hash->loose_mm};
        std::int32_t lo[3], hi[3], brick_lo[3], brick_hi[3];
        bool apart = false;
        for (int k = 0; k < 3; ++k) {
            const double least = at[k] + std::min(way[k], 0.0) - grown, most = at[k] + std::max(way[k], 0.0) + grown;
            const double first = 4.0 * level.hash->brick_min[k], last = 4.0 * level.hash->brick_max[k] + 3.0;
            const double a = std::max(std::floor(least * inverse), first),
                         b = std::min(std::floor(most * inverse), last);
            if (!(a <= b)) {
                apart = true;
                break;
            }
            lo[k] = static_cast<std::int32_t>(a), hi[k] = static_cast<std::int32_t>(b);
            brick_lo[k] = lo[k] >> 2, brick_hi[k] = hi[k] >> 2;
        }
        if (apart) continue;
        bool fits = true;
        const std::uint32_t* cells = level.cells.data();
        const BlockBound* bounds = surface_->bounds.data();
        const TriBlock* blocks = level.blocks.data();
        const auto part = static_cast<std::uint16_t>(part_);
        counters.cells += surface_->occupancy.for_bricks(level, brick_lo, brick_hi, [&](const Brick& brick) {
            const std::int32_t base[3] = {brick.x * 4, brick.y * 4, brick.z * 4};
            int low[3], high[3];
            for (int k = 0; k < 3; ++k) low[k] = std::max(lo[k] - base[k], 0), high[k] = std::min(hi[k] - base[k], 3);
            for (std::uint64_t bits = brick.mask & cells_in_range(low, high); bits != 0; bits &= bits - 1) {
                ++counters.cells;
                const std::uint32_t cell = cell_of(brick, std::countr_zero(bits));
                const std::uint32_t end = cells[cell + 1];
                std::uint32_t b = cells[cell];
                if (n + (end - b) > Around::kMost) return fits = false;
                counters.triangles += 8 * (end - b);
                for (; b < end; ++b, ++n) out.bounds[n] = bounds[b], out.blocks[n] = blocks + b, out.part[n] = part;
            }
            return true;
        });
        if (!fits) return false;
    }
    out.count = n;
    return true;
}

// The balls of one node against the blocks around it, eight balls at a time.
bool Candidates::gather_balls(std::uint32_t index, double reach, TickCounters& counters) {
    const std::span<const SolverBall> balls = solver_balls_;
    constexpr std::uint32_t kChunk = 32;
    const ToolTree::Node& node = tree_->nodes()[index];
    const BallPack& pack = tree_->pack(index);
    std::uint32_t active = 0;
    double extent[8] = {}, widest = 0.0;  // of the kept balls about the node
    for (std::uint32_t k = 0; k < node.count; ++k) {
        const std::uint32_t ball = tree_->ball(node.first + k);
        if (ball >= balls.size() || balls_clear_until_[node.first + k] - odometer_ > reach) continue;
        if (balls.size() == 1) return gather_one(node.first + k, reach, counters);
        active |= 1u << k;
        extent[k] = norm(balls[ball].offset - node.offset) + balls[ball].kept;
        widest = std::max(widest, extent[k]);
        ++counters.balls;
    }
    if (active == 0) return true;
    const double outer = widest + reach;
    const Vec3 centre = centre_ + node.offset;
    const float at[3] = {static_cast<float>(centre.x), static_cast<float>(centre.y), static_cast<float>(centre.z)};
    const float within = static_cast<float>(reach) * 1.00001f;
    float least[8], low[8 * kChunk];
    std::uint32_t bits[kChunk], near = 0;
    std::fill_n(least, 8, std::numeric_limits<float>::max());
    const bool complete = for_blocks(
        centre, outer, counters,
        [&](std::uint32_t from, std::uint32_t end) {
            for (; from < end; from += kChunk) {
                const std::uint32_t count = std::min(end - from, kChunk);
                kernels_->near(&surface_->bounds[from], count, pack, at, active, within, least, low, bits);
                for (std::uint32_t b = 0; b < count; ++b)
                    for (near |= bits[b]; bits[b] != 0; bits[b] &= bits[b] - 1) {
                        const auto lane = static_cast<std::uint32_t>(std::countr_zero(bits[b]));
                        if (block_count_ == kMaxBlocks) return false;
                        list(from + b, part_ << 16 | tree_->ball(node.first + lane), double{low[8 * b + lane]});
                    }
            }
            return true;
        },
        [] { return true; });
    if (!complete) return false;
    // Nothing within reach of a ball: until the tool has moved as far as the nearest block beyond, leave it be.
    for (std::uint32_t k = 0; k < node.count; ++k)
        if (active >> k & 1u) {
            const double clear =
                near >> k & 1u ? 0.0 : std::max(std::min(outer - extent[k], double{least[k]} * 0.99999), reach);
            balls_clear_until_[node.first + k] = odometer_ + clear;
        }
    return true;
}

// Of several parts those are left aside whose boxes no query of this gather reaches.
void Candidates::choose_parts(const Vec3& centre, double reach) {
    near_count_ = 0;
    const double range = tool_mm_ + reach + std::max(2.0 * level_->cell_mm, 3.0 * reach);
    for (std::uint32_t v = 0; v < level_->visible_count; ++v) {
        const std::uint32_t part = level_->visible[v];
        if (level_->boxes[part].distance2(centre) > range * range) continue;
        near_parts_[near_count_++] = part;
    }
}

bool Candidates::gather_node(std::uint32_t index, double reach, TickCounters& counters) {
    const std::span<const SolverBall> balls = solver_balls_;
    const ToolTree::Node& node = tree_->nodes()[index];
    if (node.least_ball >= balls.size() || nodes_clear_until_[index] - odometer_ > reach) return true;
    // A node that was near a moment ago is near now: look at its children at once.
    if (nodes_looked_at_[index] < odometer_ - 4.0 * reach) {
        const double outer = node.radius + reach + std::max(2.0 * level_->cell_mm, 3.0 * reach);
        const double clear = empty_within(centre_ + node.offset, outer, counters) - node.radius;
        ++counters.balls;
        nodes_looked_at_[index] = odometer_;
        if (clear > reach) {
            nodes_clear_until_[index] = odometer_ + clear;
            return true;
        }
    }
    double until = std::numeric_limits<double>::infinity();
    if (node.above_balls) {
        if (!gather_balls(index, reach, counters)) return false;
        for (std::uint32_t k = node.first; k < node.first + node.count; ++k)
            if (tree_->ball(k) < balls.size()) until = std::min(until, balls_clear_until_[k]);
    } else {
        for (std::uint32_t k = node.first; k < node.first + node.count; ++k) {
            if (!gather_node(k, reach, counters)) return false;
            if (tree_->nodes()[k].least_ball < balls.size()) until = std::min(until, nodes_clear_until_[k]);
        }
    }
    nodes_clear_until_[index] = until;
    nodes_looked_at_[index] = odometer_;
    return true;
}

double Candidates::gather(const Vec3& centre, double reach, double path, double off, std::span<const SolverBall> balls,
                          TickCounters& counters) {
    solver_balls_ = balls;
    odometer_ += norm(centre - centre_);
    centre_ = centre;
    turned_ = 0.0;
    std::swap(pairs_, last_pairs_);
    std::swap(keys_, last_keys_);
    last_count_ = block_count_;
    last_evaluated_ = evaluated_;
    last_path_ = path;
    off_ = off;
    near_ = 0.5 * reach;
    if (level_->visible_count != 1) choose_parts(centre, reach);
    bool complete = false;
    for (int attempt = 0; attempt < 13; ++attempt) {
        block_count_ = 0;
        if (last_evaluated_ > 0) remember();
        complete = gather_node(tree_->root(), reach, counters);
        if (complete) break;
        // Too many triangles near: take a shorter reach. Safe distances found so far stay true.
        reach *= 0.5;
    }
    // Evaluations go to the pairs that are listed again; those of the others are free.
    for (std::uint32_t i = 0; last_evaluated_ > 0 && i < block_count_; ++i)
        if (pairs_[i].stamp != kListed) last_pairs_[known(pairs_[i].block, pairs_[i].whose).index].stamp = kListed;
    if (last_evaluated_ > 0) release();
    valid_ = true;
    // With nothing near, the candidates (none) stay complete for as long as the tool is clear.
    reach_ = block_count_ == 0 && complete ? std::max(reach, nodes_clear_until_[tree_->root()] - odometer_) : reach;
    return complete ? reach_ : 0.0;
}

}  // namespace hapticlod
