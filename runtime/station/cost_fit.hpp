// What the counters of a tick cost on this machine: the model of hapticlod/station.py (CostCoefficients) and the robust
// fit of tuning/calibrate.py, in C++ so that a station needs no Python.
#pragma once
#include <array>
#include <span>

#include "station/cost_course.hpp"

namespace hapticlod::station {

inline constexpr double kCacheMb = 32.0;
// Of a tick, whatever the level's size; then of what it counts, times 1 + gain s / (s + 32 MB) on a level of s MB.
inline constexpr std::size_t kIdleTerms = 2, kTerms = 9;
inline constexpr const char* kPriceNames[kTerms] = {"base_ns",     "carried_ball_ns", "cell_ns",
                                                    "triangle_ns", "test_ns",         "iteration_ns",
                                                    "ball_ns",     "mapping_cell_ns", "union_test_ns"};
using Terms = std::array<double, kTerms>;

// One, the level's balls but one, the counters, and the tests that go from ball to ball.
[[nodiscard]] Terms counted(const TimedTick& tick);

struct CostPrices {
    Terms price_ns{};  // of `counted`
    double cache_gain = 0.0;
    double tail_p99 = 1.0, tail_p999 = 1.0;  // measured over predicted, of the dearest tenth of ticks

    [[nodiscard]] double cost_ns(const TimedTick& tick) const;
};

[[nodiscard]] CostPrices fit_prices(std::span<const TimedTick> ticks);

// Predicted over measured, and the median of what single ticks are off by.
struct Agreement {
    double mean_ratio = 0.0, p999_ratio = 0.0, median_error = 0.0;
};
[[nodiscard]] Agreement compare(const CostPrices& prices, std::span<const TimedTick> ticks);

}  // namespace hapticlod::station
