// Structure of a bundle: header and section table, checked against the bytes that are really there.
#pragma once
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "io/bundle_format.hpp"
#include "io/result.hpp"

namespace hapticlod {

struct Section {
    SectionEntry entry;
    std::span<const std::byte> bytes;  // 64-byte aligned where the file is mapped

    [[nodiscard]] std::string name() const;  // "VERTICES of level 2"
    [[nodiscard]] bool known() const;        // this runtime can read its type and version
    // An array of a level that takes time to read: its digest is left to the caller.
    [[nodiscard]] bool large() const;
    // Whether the digest is right. The signature signs header and table, so the table cannot hold its digest: it
    // vouches for itself.
    [[nodiscard]] bool intact() const;
    [[nodiscard]] Fault damaged(const std::string& path) const;
};

// Header, table, bounds, order, zero padding and the digests of all sections that are not large().
// `path` is for messages only.
// Sections of unknown type or version are kept here when optional, and refused by name otherwise.
[[nodiscard]] Result<std::vector<Section>> read_section_table(std::span<const std::byte> file, const std::string& path);

}  // namespace hapticlod
