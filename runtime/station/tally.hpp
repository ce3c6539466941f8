// What a run adds up, tick by tick, without allocating.
#pragma once
#include <array>
#include <cstdint>

#include "core/layout.hpp"
#include "station/histogram.hpp"

namespace hapticlod::station {

struct Tally {
    Histogram loop_cost;  // computing of a tick alone
    Histogram wake_up;    // from the deadline to the thread's running
    std::uint64_t ticks = 0;
    std::uint64_t skipped = 0;               // deadlines that were left out to keep the phase
    std::uint64_t ticks_without_report = 0;  // in which nothing was rendered
    std::uint64_t contact_ticks = 0;
    std::uint64_t switches = 0;
    std::uint64_t longest_over_budget_run = 0;
    std::array<std::uint64_t, kMaxLevels> level_ticks{};
    std::array<double, kMaxLevels> level_speed_sum_mm_s{};
    std::array<std::uint64_t, 4> mappings{};  // by MappingOutcome
    std::uint32_t tick_errors = 0;            // every TickError bit that was ever set
    double max_force_n = 0.0;                 // as sent
    double max_speed_mm_s = 0.0;

    void add(const TickRecord& record, const double sent_n[3], bool over_budget) noexcept;

private:
    int last_level_ = -1;
    std::uint64_t over_budget_run_ = 0;
};

}  // namespace hapticlod::station
