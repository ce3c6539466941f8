// Keys of brick coordinates: the hash that places them in a level's table, and Morton order for memory locality.
#pragma once
#include <cstdint>

namespace hapticlod {

// Part of the bundle format: the table of a stored level is probed with it.
constexpr std::uint32_t brick_hash(std::int32_t x, std::int32_t y, std::int32_t z) {
    std::uint32_t h = static_cast<std::uint32_t>(x) * 0x9e3779b1u ^ static_cast<std::uint32_t>(y) * 0x85ebca77u ^
                      static_cast<std::uint32_t>(z) * 0xc2b2ae3du;
    h ^= h >> 15;
    h *= 0x2c1b3c6du;
    return h ^ (h >> 13);
}

constexpr std::uint64_t spread3(std::uint64_t v) {
    v &= 0x1fffff;
    v = (v | v << 32) & 0x1f00000000ffffull;
    v = (v | v << 16) & 0x1f0000ff0000ffull;
    v = (v | v << 8) & 0x100f00f00f00f00full;
    v = (v | v << 4) & 0x10c30c30c30c30c3ull;
    return (v | v << 2) & 0x1249249249249249ull;
}

constexpr std::uint64_t morton(std::int32_t x, std::int32_t y, std::int32_t z) {
    constexpr std::int32_t bias = 1 << 20;
    return spread3(static_cast<std::uint64_t>(x + bias)) | spread3(static_cast<std::uint64_t>(y + bias)) << 1 |
           spread3(static_cast<std::uint64_t>(z + bias)) << 2;
}

}  // namespace hapticlod
