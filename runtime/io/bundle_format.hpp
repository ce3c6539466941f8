// The .hlod container, format 1, byte for byte. docs/bundle.md is the specification; hapticlod/bundle/format.py the
// Python mirror. Little-endian, no padding holes.
#pragma once
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

namespace hapticlod {

static_assert(std::endian::native == std::endian::little, "bundles are mapped in place: little-endian machines only");

// Like PNG's: a text-mode transfer, which rewrites line ends, breaks it visibly.
inline constexpr std::array<std::uint8_t, 8> kBundleMagic = {0x89, 'H', 'L', 'O', 'D', '\r', '\n', 0x1a};
inline constexpr std::uint32_t kBundleVersion = 1;
inline constexpr std::uint64_t kSectionAlignment = 64;
inline constexpr std::uint32_t kMaxSections = 8192;
inline constexpr std::uint32_t kMaxStoredLevels = 512;  // of a scene: all levels of all parts, one after the other
inline constexpr std::uint64_t kMaxManifestBytes = 16u << 20;
inline constexpr std::uint32_t kSectionOptional = 1u << 0;  // a reader that does not know the section skips it

using Digest = std::array<std::uint8_t, 32>;  // BLAKE2b-256

struct BundleHeader {
    std::array<std::uint8_t, 8> magic;
    std::uint32_t version;
    std::uint32_t section_count;
    std::uint64_t file_bytes;
    std::uint64_t table_offset;  // 64
    Digest table_digest;         // of all section entries
};
static_assert(sizeof(BundleHeader) == 64);

enum class SectionType : std::uint32_t {
    manifest = 1,
    config = 2,
    tool = 3,
    parts = 4,  // only where the bundle is a scene; a reader may not do without
    vertices = 16,
    faces = 17,
    adjacency = 18,  // 18..24 speed a level up and can be rebuilt from 16 and 17
    normals = 19,
    hash = 20,
    table = 21,
    bricks = 22,
    cells = 23,
    blocks = 24,
    materials = 25,  // only where the scan has any; a reader may not do without
    bounds = 30,     // of the blocks of all levels, one after the other; speeds up opening, and can be made anew
    golden_motion = 32,
    golden_record = 33,
    signature = 48,
};

struct SectionEntry {
    std::uint32_t type;     // SectionType
    std::uint32_t version;  // of this section's layout
    std::uint32_t level;    // 0 is the finest; 0 for sections that belong to no level
    std::uint32_t flags;    // kSectionOptional
    std::uint64_t offset;   // from the start of the file, a multiple of kSectionAlignment
    std::uint64_t length;   // bytes, without the zeros that fill up to the next section
    Digest digest;          // of those bytes; zero for the signature, which signs header and table
};
static_assert(sizeof(SectionEntry) == 64);

// One part of a scene. Its levels are the stored levels that follow those of the part before; at the scene's level k it
// shows its level min(k, level_count - 1).
struct PartData {
    char name[64];              // UTF-8, 1 to 63 bytes, the rest zero
    std::uint32_t level_count;  // 1..8, at most the config's
    std::uint32_t flags;        // bit 0: hidden at first
    double position_mm[3];      // where the scan was put: for people, the vertices have been moved
    double orientation[4];      // unit quaternion w x y z: first turned, then moved
    double cell_mm[8];          // voxel edge, per level of the part
    std::uint32_t triangles[8];
    std::uint32_t reserved[8];  // 0
};
static_assert(sizeof(PartData) == 256);
inline constexpr std::uint32_t kPartHidden = 1u << 0;

// The layout of every section type that this runtime reads.
inline constexpr std::uint32_t kSectionVersion = 1;

[[nodiscard]] constexpr bool is_acceleration(std::uint32_t type) {
    return type >= static_cast<std::uint32_t>(SectionType::adjacency) &&
           type <= static_cast<std::uint32_t>(SectionType::blocks);
}

[[nodiscard]] constexpr bool is_level_section(std::uint32_t type) {
    return type >= static_cast<std::uint32_t>(SectionType::vertices) &&
           type <= static_cast<std::uint32_t>(SectionType::materials);
}

// Name of a section type, "unknown" where this runtime has none.
[[nodiscard]] constexpr const char* section_name(std::uint32_t type) {
    switch (static_cast<SectionType>(type)) {
        case SectionType::manifest:
            return "MANIFEST";
        case SectionType::config:
            return "CONFIG";
        case SectionType::tool:
            return "TOOL";
        case SectionType::parts:
            return "PARTS";
        case SectionType::vertices:
            return "VERTICES";
        case SectionType::faces:
            return "FACES";
        case SectionType::adjacency:
            return "ADJACENCY";
        case SectionType::normals:
            return "NORMALS";
        case SectionType::hash:
            return "HASH";
        case SectionType::table:
            return "TABLE";
        case SectionType::bricks:
            return "BRICKS";
        case SectionType::cells:
            return "CELLS";
        case SectionType::blocks:
            return "BLOCKS";
        case SectionType::materials:
            return "MATERIALS";
        case SectionType::bounds:
            return "BOUNDS";
        case SectionType::golden_motion:
            return "GOLDEN_MOTION";
        case SectionType::golden_record:
            return "GOLDEN_RECORD";
        case SectionType::signature:
            return "SIGNATURE";
    }
    return "unknown";
}

}  // namespace hapticlod
