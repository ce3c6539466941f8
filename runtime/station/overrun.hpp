// Time-critical level of detail: a tick that took longer than its budget makes the next ticks coarser, one level per
// overrun; after a while without, one level finer again.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

namespace hapticlod::station {

class OverrunGovernor {
public:
    // A floor is kept this long before it is lowered by one level: every change is a switch that a hand may feel.
    static constexpr double kHold_s = 0.2;

    OverrunGovernor(std::uint32_t level_count, double period_s)
        : coarsest_(level_count - 1), hold_ticks_(static_cast<std::uint32_t>(std::ceil(kHold_s / period_s))) {}

    // After each tick. Returns the coarsest floor for the next one.
    std::uint32_t update(bool over_budget, std::uint32_t level_used) noexcept {
        if (over_budget) {
            const std::uint32_t before = floor_;
            floor_ = std::min(coarsest_, std::max(floor_, level_used) + 1);
            raised_ += floor_ > before ? 1 : 0;
            hold_ = hold_ticks_;
        } else if (floor_ > 0 && --hold_ == 0) {
            --floor_;
            hold_ = hold_ticks_;
        }
        return floor_;
    }

    // How often the floor went up.
    [[nodiscard]] std::uint64_t raised() const { return raised_; }

private:
    std::uint32_t coarsest_;
    std::uint32_t hold_ticks_;
    std::uint32_t floor_ = 0;
    std::uint32_t hold_ = 0;
    std::uint64_t raised_ = 0;
};

}  // namespace hapticlod::station
