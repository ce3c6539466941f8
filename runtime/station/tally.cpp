#include "station/tally.hpp"

#include <algorithm>
#include <cmath>

namespace hapticlod::station {

void Tally::add(const TickRecord& record, const double sent_n[3], bool over_budget) noexcept {
    ++ticks;
    loop_cost.record(std::llround(record.cost_ns));
    contact_ticks += record.contact;
    switches += last_level_ >= 0 && last_level_ != record.level ? 1 : 0;
    last_level_ = record.level;
    const std::size_t level = std::min<std::size_t>(record.level, kMaxLevels - 1);
    ++level_ticks[level];
    level_speed_sum_mm_s[level] += static_cast<double>(record.speed_mm_s);
    ++mappings[record.mapping & 3];
    tick_errors |= record.errors;
    over_budget_run_ = over_budget ? over_budget_run_ + 1 : 0;
    longest_over_budget_run = std::max(longest_over_budget_run, over_budget_run_);
    max_force_n = std::max(max_force_n, std::hypot(sent_n[0], sent_n[1], sent_n[2]));
    max_speed_mm_s = std::max(max_speed_mm_s, static_cast<double>(record.speed_mm_s));
}

}  // namespace hapticlod::station
