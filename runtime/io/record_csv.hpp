// Writes what the ticks gave as CSV: one row per tick, every field of TickRecord with its unit in the header.
// Numbers are shortest-round-trip: reading them back gives the same bits.
#pragma once
#include <span>
#include <string>

#include "core/layout.hpp"

namespace hapticlod {

[[nodiscard]] std::string record_csv(std::span<const TickRecord> rows);

}  // namespace hapticlod
