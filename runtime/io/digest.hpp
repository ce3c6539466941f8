// BLAKE2b-256, the digest of every part of a bundle.
#pragma once
#include <cstddef>
#include <span>
#include <string>

#include "io/bundle_format.hpp"

namespace hapticlod {

[[nodiscard]] Digest blake2b_256(std::span<const std::byte> bytes);
[[nodiscard]] std::string hex(const Digest& digest);

}  // namespace hapticlod
