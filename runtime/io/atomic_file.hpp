// Files are never half-written: write beside, fsync, rename.
#pragma once
#include <optional>
#include <string>
#include <string_view>

#include "io/result.hpp"

namespace hapticlod {

// Whole content or nothing; the fault says why it could not be written.
[[nodiscard]] std::optional<Fault> write_file_atomic(const std::string& path, std::string_view content);

}  // namespace hapticlod
