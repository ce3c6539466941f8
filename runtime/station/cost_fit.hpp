// What the counters of a tick cost on this machine: the model of hapticlod/station.py (CostCoefficients), but for what
// a tool of many balls costs on top (carried_ball_ns, union_test_ns: left 0), and the same robust fit as
// tuning/calibrate.py, in C++ so that a station needs no Python.
#pragma once
#include <array>
#include <span>

#include "station/cost_course.hpp"

namespace hapticlod::station {

// cost = price[0] + (cells, triangles, tests, iterations, balls, mapping cells) . price[1..6] * (1 + gain s / (s + 32
// MB))
struct CostPrices {
    std::array<double, 7> price_ns{};
    double cache_gain = 0.0;
    double tail_p99 = 1.0, tail_p999 = 1.0;  // measured over predicted, of the dearest tenth of ticks

    [[nodiscard]] double cost_ns(const TimedTick& tick) const;
};
inline constexpr double kCacheMb = 32.0;
inline constexpr const char* kPriceNames[] = {"base_ns",      "cell_ns", "triangle_ns",    "test_ns",
                                              "iteration_ns", "ball_ns", "mapping_cell_ns"};

[[nodiscard]] CostPrices fit_prices(std::span<const TimedTick> ticks);

}  // namespace hapticlod::station
