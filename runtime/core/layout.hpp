// Plain records shared by the core, the bundle, the bindings and telemetry. Python mirrors them in
// hapticlod/layout.py; a test compares sizes and offsets. All little-endian, no padding holes.
#pragma once
#include <cstddef>
#include <cstdint>

namespace hapticlod {

inline constexpr std::uint32_t kMaxLevels = 8;
inline constexpr std::uint32_t kMaxBalls = 4096;
inline constexpr std::uint32_t kConfigVersion = 1;

enum class Mapping : std::uint32_t { paper = 0, two_sided = 1 };
enum class Policy : std::uint32_t { velocity = 0, distance = 1 };
enum class MappingOutcome : std::uint8_t { none = 0, hit = 1, closest = 2, miss = 3 };

// Everything the tick is tuned by. Section CONFIG of a bundle, byte for byte.
struct ConfigData {
    std::uint32_t version;      // kConfigVersion
    std::uint32_t level_count;  // 1..kMaxLevels, level 0 is the finest
    std::uint32_t mapping;      // Mapping
    std::uint32_t policy;       // Policy
    std::uint32_t shading;      // 1: force along interpolated normals
    std::uint32_t flags;        // 0
    double origin_mm[3];        // level vertices are float32 relative to this point of the scan frame
    double loop_hz;
    double budget_us;
    double stiffness_n_mm;
    double damping_n_s_mm;
    double friction_static;
    double friction_dynamic;
    double filter_hz;   // one-pole low-pass on velocity; 0: raw difference (the paper)
    double hysteresis;  // eta: up above V (1 + eta), down below V (1 - eta)
    double dwell_s;     // least time between two switches
    double l_in_mm;     // mapping segment [SCP - l_in n, SCP + l_out n]
    double l_out_mm;
    double closest_bound_mm;  // two-sided mapping: fallback to the closest point within this bound
    double blend_s;           // tau_b: a switch's offset decays linearly to 0 over this time; 0: off
    double max_force_n;
    double max_slew_n_s;             // 0: no slew limit
    double engage_s;                 // soft engagement after a start in overlap
    double crack_mm;                 // gaps up to this width hold a tool of radius 0
    double work_limit;               // of a tick, see TickCounters::work(): then it is cut short; 0: none
    double reserved[7];              // 0
    double speeds_mm_s[kMaxLevels];  // V_i between level i and i+1; level_count - 1 used
    double cell_mm[kMaxLevels];      // voxel edge
    std::uint32_t triangles[kMaxLevels];
    std::uint32_t balls[kMaxLevels];  // first balls of the tool used at the level
};
static_assert(sizeof(ConfigData) == 440);

// One ball of a tool, in the tool's frame. Tools are stored in nested order: the first P balls describe it best.
struct BallData {
    double centre_mm[3];
    double radius_mm;
};
static_assert(sizeof(BallData) == 32);

// Error bits of a tick. Never logged in the loop; the caller reads them.
enum TickError : std::uint32_t {
    kErrHipNotFinite = 1u << 0,    // HIP or orientation was NaN or inf: last pose held
    kErrPeriod = 1u << 1,          // time did not advance: nominal period used
    kErrHipJump = 1u << 2,         // HIP moved further than the model is large: contact reset
    kErrNotConverged = 1u << 3,    // constraint iterations exhausted: SCP is safe but not final
    kErrCandidates = 1u << 4,      // more nearby triangles than the scratch holds: reach was shortened
    kErrContactLost = 1u << 5,     // a level switch in contact found no surface
    kErrForceClamped = 1u << 6,    // force limit reached
    kErrSlewLimited = 1u << 7,     // slew limit reached
    kErrForceNotFinite = 1u << 8,  // force was not finite: 0 sent
    kErrStartInside = 1u << 9,     // started in overlap: engaged softly
    kErrTurnHeld = 1u << 10,       // a rotation was too large for one tick or barred by the surface: the rest follows
};

// What one tick gave. Also the golden record of a bundle and the telemetry row.
struct TickRecord {
    double time_s;
    double hip_mm[3];
    double scp_mm[3];  // rendered SCP: mapped contact plus the decaying blend offset
    double force_n[3];
    double torque_n_mm[3];  // about the tool's reference point
    float speed_mm_s;
    float cost_ns;
    std::uint8_t level;
    std::uint8_t contact;         // 1: force is not zero by construction (SCP differs from HIP)
    std::uint8_t mapping;         // MappingOutcome
    std::uint8_t constraints;     // active constraints, 0..3
    std::uint32_t errors;         // TickError bits
    std::uint32_t cells;          // hash cells visited (contact and mapping)
    std::uint32_t triangles;      // triangles gathered from cells
    std::uint32_t tests;          // triangle distances in the solver; a bound that spares eight of them counts as one
    std::uint32_t iterations;     // constraint iterations
    std::uint32_t balls;          // balls whose safe distance had to be renewed
    std::uint32_t mapping_cells;  // part of `cells` that mapping visited
};
static_assert(sizeof(TickRecord) == 144);

// ---- Level arrays, in the order of the bundle's sections --------------------------------------------------

inline constexpr std::uint32_t kNoNeighbour = 0xffffffffu;

// What the surface is made of at one vertex (docs/materials.md). kAsStation: not stated, so it is the station's.
inline constexpr float kAsStation = -1.0f;
struct Material {
    float stiffness_n_mm;  // never more than the station's is rendered
    float friction_static;
    float friction_dynamic;  // at most the static one; both are stated or neither
};
static_assert(sizeof(Material) == 12);

// Eight triangles of one cell, structure of arrays, 64-byte aligned. Unused lanes repeat lane 0 and carry
// id kNoNeighbour.
struct alignas(64) TriBlock {
    float v[9][8];  // v0.x v0.y v0.z v1.x ... v2.z
    std::uint32_t id[8];
};
static_assert(sizeof(TriBlock) == 320);

// A block's triangles lie in this ball and in this slab: |p - centre| <= radius, |normal.(p - centre)| <= half. So they
// lie in a disc along the normal. On a smooth surface that says almost exactly how far a ball is above it. Most blocks
// are passed over by this alone.
struct alignas(32) BlockBound {
    float x, y, z, radius;
    float nx, ny, nz, half;
};
static_assert(sizeof(BlockBound) == 32);

// 4 x 4 x 4 cells. Bit (x + 4 y + 16 z) of mask is set where the cell holds triangles; the k-th set bit's cell is
// cells[first_cell + k]. Cell c owns blocks[cells[c] .. cells[c + 1]).
struct Brick {
    std::int32_t x, y, z;  // brick coordinates: floor(position / (4 cell_mm))
    std::uint32_t first_cell;
    std::uint64_t mask;
};
static_assert(sizeof(Brick) == 24);

struct HashHeader {
    double cell_mm;
    std::uint32_t table_size;  // power of two; slots hold brick index + 1, 0 = empty; linear probing
    std::uint32_t brick_count;
    std::uint32_t cell_count;
    std::uint32_t block_count;
    std::int32_t brick_min[3];  // bounds of occupied bricks, inclusive
    std::int32_t brick_max[3];
    float bbox_min[3];
    float bbox_max[3];
    float max_edge_mm;
    float mean_edge_mm;
    float loose_mm;  // a triangle listed in one cell alone may stand out of it by this
    std::uint32_t reserved[5];
};
static_assert(sizeof(HashHeader) == 104);

}  // namespace hapticlod
