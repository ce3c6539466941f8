// Building a level: voxel hash in bricks of 4 x 4 x 4 cells, face adjacency, vertex normals.
#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/level.hpp"
#include "core/material.hpp"
#include "core/morton.hpp"
#include "core/triangle.hpp"

namespace hapticlod {
namespace {

constexpr std::uint32_t kBrickCells = 64;

Vec3 vertex(std::span<const float> v, std::uint32_t i) {
    return {v[3 * std::size_t{i}], v[3 * std::size_t{i} + 1], v[3 * std::size_t{i} + 2]};
}

// Does the triangle meet the box (centre, half edge)? Separating axes (Akenine-Moeller 2001), box grown by a margin so
// that a point of the triangle always lies in a cell that lists it, whatever the rounding.
bool meets_box(const Triangle& t, const Vec3& centre, double half) {
    const Vec3 a = t.a - centre, b = t.b - centre, c = t.c - centre;
    const auto apart = [half](double p, double q, double r, double radius) {
        return std::min({p, q, r}) > radius * half || std::max({p, q, r}) < -radius * half;
    };
    if (apart(a.x, b.x, c.x, 1.0) || apart(a.y, b.y, c.y, 1.0) || apart(a.z, b.z, c.z, 1.0)) return false;
    const Vec3 edges[3] = {b - a, c - b, a - c};
    const Vec3 n = cross(edges[0], edges[1]);
    if (std::abs(dot(n, a)) > half * (std::abs(n.x) + std::abs(n.y) + std::abs(n.z))) return false;
    for (const Vec3& e : edges) {
        if (apart(e.z * a.y - e.y * a.z, e.z * b.y - e.y * b.z, e.z * c.y - e.y * c.z, std::abs(e.z) + std::abs(e.y)))
            return false;
        if (apart(e.x * a.z - e.z * a.x, e.x * b.z - e.z * b.x, e.x * c.z - e.z * c.x, std::abs(e.x) + std::abs(e.z)))
            return false;
        if (apart(e.y * a.x - e.x * a.y, e.y * b.x - e.x * b.y, e.y * c.x - e.x * c.y, std::abs(e.y) + std::abs(e.x)))
            return false;
    }
    return true;
}

// Bricks while building: open addressing on brick coordinates.
class BrickTable {
public:
    explicit BrickTable(std::size_t expected) { resize(std::bit_ceil(std::max<std::size_t>(64, 2 * expected))); }

    std::uint32_t find_or_add(std::int32_t x, std::int32_t y, std::int32_t z) {
        if (last_ != kEmpty && bricks[last_].x == x && bricks[last_].y == y && bricks[last_].z == z) return last_;
        std::size_t slot = brick_hash(x, y, z) & mask_;
        while (slots_[slot] != kEmpty) {
            const Brick& b = bricks[slots_[slot]];
            if (b.x == x && b.y == y && b.z == z) return last_ = slots_[slot];
            slot = (slot + 1) & mask_;
        }
        slots_[slot] = last_ = static_cast<std::uint32_t>(bricks.size());
        bricks.push_back({x, y, z, 0, 0});
        if (2 * bricks.size() > slots_.size()) grow();
        return last_;
    }

    std::vector<Brick> bricks;

private:
    static constexpr std::uint32_t kEmpty = 0xffffffffu;

    void resize(std::size_t size) {
        slots_.assign(size, kEmpty);
        mask_ = size - 1;
    }
    void grow() {
        resize(2 * slots_.size());
        for (std::uint32_t i = 0; i < bricks.size(); ++i) {
            std::size_t slot = brick_hash(bricks[i].x, bricks[i].y, bricks[i].z) & mask_;
            while (slots_[slot] != kEmpty) slot = (slot + 1) & mask_;
            slots_[slot] = i;
        }
    }

    std::vector<std::uint32_t> slots_;
    std::size_t mask_ = 0;
    std::uint32_t last_ = kEmpty;
};

// A triangle listed once may stand out of its cell by this much of the cell's edge.
constexpr double kMostLoose = 0.35;

// What a mesh from anywhere may ask for: its coordinates' products stay finite, listing its triangles ends.
constexpr double kMostExtent = 1e15;
#ifdef HAPTICLOD_FEW_BLOCKS  // fuzzing: not a second each for bundles of a few huge triangles
constexpr double kMostVisited = 16384.0;
#else
constexpr double kMostVisited = 16777216.0;  // and more by the triangle: a second of work at most
#endif
constexpr double kMostVisitedEach = 1024.0;

// Triangles along a Morton curve through their first corners: least-significant-digit radix sort of 30-bit keys.
std::vector<std::uint32_t> morton_order(std::span<const float> vertices, std::span<const std::uint32_t> faces,
                                        const HashHeader& h) {
    float size = 0.0f;
    for (int k = 0; k < 3; ++k) size = std::max(size, h.bbox_max[k] - h.bbox_min[k]);
    const float scale = size > 1e-30f ? 1023.0f / size : 0.0f;  // smaller ones would overflow
    const std::size_t n = faces.size() / 3;
    struct Keyed {
        std::uint32_t key, face;
    };
    std::vector<Keyed> from(n), to(n);
    for (std::size_t f = 0; f < n; ++f) {
        const float* v = &vertices[3 * std::size_t{faces[3 * f]}];
        const auto at = [&](int k) { return static_cast<std::int32_t>((v[k] - h.bbox_min[k]) * scale); };
        const std::uint64_t key = spread3(static_cast<std::uint64_t>(at(0))) |
                                  spread3(static_cast<std::uint64_t>(at(1))) << 1 |
                                  spread3(static_cast<std::uint64_t>(at(2))) << 2;
        from[f] = {static_cast<std::uint32_t>(key), static_cast<std::uint32_t>(f)};
    }
    constexpr int kDigit = 10;
    for (int shift = 0; shift < 30; shift += kDigit) {
        std::vector<std::uint32_t> at((std::size_t{1} << kDigit) + 1, 0);
        const auto digit = [shift](std::uint32_t key) { return key >> shift & ((1u << kDigit) - 1); };
        for (const Keyed& e : from) ++at[digit(e.key) + 1];
        std::partial_sum(at.begin(), at.end(), at.begin());
        for (const Keyed& e : from) to[at[digit(e.key)]++] = e;
        from.swap(to);
    }
    std::vector<std::uint32_t> order(n);
    for (std::size_t i = 0; i < n; ++i) order[i] = from[i].face;
    return order;
}

struct Entry {
    std::uint32_t cell;  // brick * 64 + cell in brick
    std::uint32_t triangle;
};

std::vector<std::uint32_t> build_adjacency(std::span<const std::uint32_t> faces, std::size_t vertex_count) {
    // Directed edges bucketed by their smaller vertex; an edge used by exactly two faces joins them.
    const std::size_t edges = faces.size();
    std::vector<std::uint32_t> first(vertex_count + 1, 0), order(edges);
    const auto ends = [&](std::size_t e) {
        const std::size_t f = e / 3, k = e % 3;
        const std::uint32_t a = faces[3 * f + k], b = faces[3 * f + (k + 1) % 3];
        return std::pair{std::min(a, b), std::max(a, b)};
    };
    for (std::size_t e = 0; e < edges; ++e) ++first[ends(e).first + 1];
    std::partial_sum(first.begin(), first.end(), first.begin());
    std::vector<std::uint32_t> next(first.begin(), first.end() - 1);
    for (std::size_t e = 0; e < edges; ++e) order[next[ends(e).first]++] = static_cast<std::uint32_t>(e);
    std::vector<std::uint32_t> adjacency(edges, kNoNeighbour);
    for (std::size_t v = 0; v < vertex_count; ++v) {
        for (std::uint32_t i = first[v]; i < first[v + 1]; ++i) {
            std::uint32_t partner = kNoNeighbour, sharing = 0;
            for (std::uint32_t j = first[v]; j < first[v + 1]; ++j) {
                if (ends(order[j]).second != ends(order[i]).second) continue;
                ++sharing;
                if (j != i) partner = order[j];
            }
            if (sharing == 2) adjacency[order[i]] = partner / 3;
        }
    }
    return adjacency;
}

std::vector<float> build_normals(std::span<const float> vertices, std::span<const std::uint32_t> faces) {
    // Weighted by the angle at the vertex (Thuermer & Wuethrich 1998): independent of the triangulation.
    std::vector<Vec3> sum(vertices.size() / 3);
    for (std::size_t f = 0; f < faces.size(); f += 3) {
        const Vec3 p[3] = {vertex(vertices, faces[f]), vertex(vertices, faces[f + 1]), vertex(vertices, faces[f + 2])};
        const Vec3 n = cross(p[1] - p[0], p[2] - p[0]);
        const double length = norm(n);
        if (!(length > 0.0)) continue;
        for (int k = 0; k < 3; ++k) {
            const Vec3 u = p[(k + 1) % 3] - p[k], w = p[(k + 2) % 3] - p[k];
            sum[faces[f + k]] += n * (std::atan2(length, dot(u, w)) / length);
        }
    }
    std::vector<float> normals(vertices.size());
    for (std::size_t i = 0; i < sum.size(); ++i) {
        const double length = norm(sum[i]);
        const Vec3 n = length > 0.0 ? sum[i] * (1.0 / length) : Vec3{};
        normals[3 * i] = static_cast<float>(n.x);
        normals[3 * i + 1] = static_cast<float>(n.y);
        normals[3 * i + 2] = static_cast<float>(n.z);
    }
    return normals;
}

}  // namespace

std::string LevelStorage::build(std::span<const float> vertices, std::span<const std::uint32_t> faces, double cell_mm) {
    const std::size_t nv = vertices.size() / 3, nf = faces.size() / 3;
    if (vertices.size() % 3 != 0 || faces.size() % 3 != 0) return "vertices and faces must come in threes";
    if (nf == 0 || nv == 0) return "the mesh has no faces";
    if (nf > kMostElements || nv > kMostElements) return "the mesh has more than 2^30 faces or vertices";
    if (!(cell_mm > 0.0) || !std::isfinite(cell_mm)) return "cell_mm must be positive and finite";
    for (const float v : vertices)
        if (!std::isfinite(v)) return "a vertex is not finite";
    for (const std::uint32_t i : faces)
        if (i >= nv) return "a face index is out of range";

    vertices_.assign(vertices.begin(), vertices.end());
    faces_.assign(faces.begin(), faces.end());

    header_ = HashHeader{};
    header_.cell_mm = cell_mm;
    for (int k = 0; k < 3; ++k) {
        header_.bbox_min[k] = std::numeric_limits<float>::max();
        header_.bbox_max[k] = -std::numeric_limits<float>::max();
    }
    for (std::size_t i = 0; i < nv; ++i)
        for (int k = 0; k < 3; ++k) {
            header_.bbox_min[k] = std::min(header_.bbox_min[k], vertices_[3 * i + k]);
            header_.bbox_max[k] = std::max(header_.bbox_max[k], vertices_[3 * i + k]);
        }
    double extent = 0.0;
    for (int k = 0; k < 3; ++k)
        extent = std::max({extent, std::abs(double{header_.bbox_min[k]}), std::abs(double{header_.bbox_max[k]})});
    if (extent > kMostExtent) return "the mesh is larger than 10^15";
    if (extent / cell_mm > 1e6) return "cell_mm is too small for the size of the mesh";

    // Pass 1: which cells does each triangle belong to? A small one to the cell of its middle alone, which it may
    // leave by `loose`; a large one to every cell it meets. In Morton order, so that blocks of eight are compact.
    const double margin = 1e-4 * cell_mm + 4e-7 * extent;
    BrickTable table(nf / 8);
    std::vector<Entry> entries;
    entries.reserve(nf + nf / 8);
    double visited = 0.0;  // cells tried, of all large triangles
    double edge_sum = 0.0, edge_max = 0.0, loose = 0.0;
    for (const std::uint32_t f : morton_order(vertices_, faces_, header_)) {
        const Triangle t{vertex(vertices_, faces_[3 * f]), vertex(vertices_, faces_[3 * f + 1]),
                         vertex(vertices_, faces_[3 * f + 2])};
        for (const double e : {norm(t.b - t.a), norm(t.c - t.b), norm(t.a - t.c)})
            edge_sum += e, edge_max = std::max(edge_max, e);
        const double least[3] = {std::min({t.a.x, t.b.x, t.c.x}), std::min({t.a.y, t.b.y, t.c.y}),
                                 std::min({t.a.z, t.b.z, t.c.z})};
        const double most[3] = {std::max({t.a.x, t.b.x, t.c.x}), std::max({t.a.y, t.b.y, t.c.y}),
                                std::max({t.a.z, t.b.z, t.c.z})};
        std::int32_t middle[3];
        double overhang = 0.0;
        for (int k = 0; k < 3; ++k) {
            middle[k] = static_cast<std::int32_t>(std::floor(0.5 * (least[k] + most[k]) / cell_mm));
            overhang = std::max({overhang, middle[k] * cell_mm - least[k], most[k] - (middle[k] + 1) * cell_mm});
        }
        const auto list = [&](std::int32_t x, std::int32_t y, std::int32_t z) {
            const std::uint32_t brick = table.find_or_add(x >> 2, y >> 2, z >> 2);
            const std::uint32_t cell = (x & 3) + 4 * (y & 3) + 16 * (z & 3);
            table.bricks[brick].mask |= std::uint64_t{1} << cell;
            entries.push_back({brick * kBrickCells + cell, f});
        };
        if (overhang <= kMostLoose * cell_mm) {
            loose = std::max(loose, overhang);
            list(middle[0], middle[1], middle[2]);
        } else {
            std::int32_t lo[3], hi[3];
            for (int k = 0; k < 3; ++k) {
                lo[k] = static_cast<std::int32_t>(std::floor((least[k] - margin) / cell_mm));
                hi[k] = static_cast<std::int32_t>(std::floor((most[k] + margin) / cell_mm));
            }
            visited += (hi[0] - lo[0] + 1.0) * (hi[1] - lo[1] + 1.0) * (hi[2] - lo[2] + 1.0);
            if (visited > kMostVisited + kMostVisitedEach * static_cast<double>(nf))
                return "cell_mm is too small for the size of the triangles";
            for (std::int32_t z = lo[2]; z <= hi[2]; ++z)
                for (std::int32_t y = lo[1]; y <= hi[1]; ++y)
                    for (std::int32_t x = lo[0]; x <= hi[0]; ++x)
                        if (meets_box(t, {(x + 0.5) * cell_mm, (y + 0.5) * cell_mm, (z + 0.5) * cell_mm},
                                      0.5 * cell_mm + margin))
                            list(x, y, z);
        }
        if (entries.size() > 0xf0000000u || table.bricks.size() > 0x3ffffffu)
            return "cell_mm is too small: the hash would not fit";
    }
    header_.loose_mm = static_cast<float>(loose * (1.0 + 1e-6) + margin);
    header_.mean_edge_mm = static_cast<float>(edge_sum / (3.0 * static_cast<double>(nf)));
    header_.max_edge_mm = static_cast<float>(edge_max);

    // Bricks in Morton order: neighbours in space are neighbours in memory.
    const std::size_t nb = table.bricks.size();
    std::vector<std::uint32_t> order(nb), rank(nb);
    std::iota(order.begin(), order.end(), 0u);
    std::vector<std::uint64_t> keys(nb);
    for (std::size_t i = 0; i < nb; ++i) keys[i] = morton(table.bricks[i].x, table.bricks[i].y, table.bricks[i].z);
    std::sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return keys[a] < keys[b]; });
    bricks_.resize(nb);
    for (std::uint32_t i = 0; i < nb; ++i) bricks_[i] = table.bricks[order[i]], rank[order[i]] = i;
    std::uint32_t cell_count = 0;
    for (int k = 0; k < 3; ++k) header_.brick_min[k] = 0x7fffffff, header_.brick_max[k] = -0x7fffffff;
    for (Brick& b : bricks_) {
        b.first_cell = cell_count;
        cell_count += static_cast<std::uint32_t>(std::popcount(b.mask));
        const std::int32_t at[3] = {b.x, b.y, b.z};
        for (int k = 0; k < 3; ++k) {
            header_.brick_min[k] = std::min(header_.brick_min[k], at[k]);
            header_.brick_max[k] = std::max(header_.brick_max[k], at[k]);
        }
    }

    // Pass 2: count, then place triangles into blocks of eight.
    std::vector<std::uint32_t> count(cell_count, 0);
    for (Entry& e : entries) {
        const Brick& b = bricks_[rank[e.cell / kBrickCells]];
        e.cell = cell_of(b, static_cast<int>(e.cell % kBrickCells));
        ++count[e.cell];
    }
    cells_.assign(cell_count + 1, 0);
    for (std::uint32_t c = 0; c < cell_count; ++c) cells_[c + 1] = cells_[c] + (count[c] + 7) / 8;
    blocks_.resize(cells_[cell_count]);
    std::fill(count.begin(), count.end(), 0);
    for (const Entry& e : entries) {
        const std::uint32_t at = count[e.cell]++;
        TriBlock& block = blocks_[cells_[e.cell] + at / 8];
        const std::uint32_t lane = at % 8;
        for (int corner = 0; corner < 3; ++corner)
            for (int k = 0; k < 3; ++k)
                block.v[3 * corner + k][lane] = vertices_[3 * std::size_t{faces_[3 * e.triangle + corner]} + k];
        block.id[lane] = e.triangle;
    }
    for (std::uint32_t c = 0; c < cell_count; ++c) {
        if (count[c] % 8 == 0) continue;
        TriBlock& block = blocks_[cells_[c + 1] - 1];
        for (std::uint32_t lane = count[c] % 8; lane < 8; ++lane) {
            for (auto& row : block.v) row[lane] = row[0];
            block.id[lane] = kNoNeighbour;
        }
    }

    const std::size_t slots = std::bit_ceil(2 * nb);
    table_.assign(slots, 0);
    for (std::uint32_t i = 0; i < nb; ++i) {
        std::size_t slot = brick_hash(bricks_[i].x, bricks_[i].y, bricks_[i].z) & (slots - 1);
        while (table_[slot] != 0) slot = (slot + 1) & (slots - 1);
        table_[slot] = i + 1;
    }
    header_.table_size = static_cast<std::uint32_t>(slots);
    header_.brick_count = static_cast<std::uint32_t>(nb);
    header_.cell_count = cell_count;
    header_.block_count = static_cast<std::uint32_t>(blocks_.size());

    adjacency_ = build_adjacency(faces_, nv);
    normals_ = build_normals(vertices_, faces_);
    return {};
}

std::string LevelStorage::set_materials(std::span<const Material> materials) {
    if (std::string fault = check_materials(materials, vertices_.size() / 3); !fault.empty()) return fault;
    materials_.assign(materials.begin(), materials.end());
    return {};
}

LevelView LevelStorage::view() const {
    return {vertices_, faces_, adjacency_, normals_, &header_, table_, bricks_, cells_, blocks_, {}, materials_};
}

}  // namespace hapticlod
