// A fixed course of timed ticks: surfaces of three sizes, tools from a point to a burr, slow and fast, with changes of
// level. Together they vary every counter by orders of magnitude, which the fit of prices needs.
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "core/layout.hpp"

namespace hapticlod::station {

struct TimedTick {
    TickRecord record;   // cost_ns: the least of several runs, as interrupts are not the tick's
    double level_bytes;  // of the level it used
    double level_balls;  // that the level has of the tool's
};

struct HeldOut {
    const char* tool;
    std::vector<TimedTick> ticks;
};

struct Course {
    std::vector<TimedTick> fitted;  // to fit prices to
    std::vector<HeldOut> held_out;  // of a surface and of tools that are not among them
};

// `ticks`: of each of some fifty replays; 1200 take five seconds. `progress`: told the share that is done.
[[nodiscard]] Course run_cost_course(std::size_t ticks, const std::function<void(double)>& progress);

}  // namespace hapticlod::station
