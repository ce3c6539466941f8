#include "station/cost_fit.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

namespace hapticlod::station {
namespace {

constexpr int kRounds = 12, kSweeps = 20'000;
constexpr double kSettled = 1e-10;   // of a coefficient in one sweep
constexpr double kScale = 0.5;       // relative error beyond which a tick counts little
constexpr double kFloor_ns = 200.0;  // below this a tick's time is mostly the clock's

double cache_factor(double bytes, double gain) {
    const double mb = 1e-6 * bytes;
    return 1.0 + gain * mb / (mb + kCacheMb);
}

double quantile(std::vector<double> values, double share) {
    if (values.empty()) return 1.0;
    const auto place = static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
    std::nth_element(values.begin(), values.begin() + place, values.end());
    return values[static_cast<std::size_t>(place)];
}

// What a tick costs before the level's size comes in: idle, and for what it counted.
struct Work {
    double idle_ns = 0.0, counted_ns = 0.0;
};

Work work_of(const Terms& terms, const Terms& price_ns) {
    Work work;
    for (std::size_t j = 0; j < kTerms; ++j) {
        (j < kIdleTerms ? work.idle_ns : work.counted_ns) += price_ns[j] * terms[j];
    }
    return work;
}

// Least squares with coefficients that are not negative, by coordinate descent on the normal equations.
Terms non_negative(const std::array<Terms, kTerms>& gram, const Terms& right, Terms start) {
    for (int sweep = 0; sweep < kSweeps; ++sweep) {
        double largest = 0.0, moved = 0.0;
        for (std::size_t j = 0; j < kTerms; ++j) {
            if (gram[j][j] <= 0.0) continue;
            double residual = right[j];
            for (std::size_t k = 0; k < kTerms; ++k) residual -= gram[j][k] * start[k];
            const double next = std::max(0.0, start[j] + residual / gram[j][j]);
            moved = std::max(moved, std::abs(next - start[j]));
            largest = std::max(largest, next);
            start[j] = next;
        }
        if (moved <= kSettled * largest) break;
    }
    return start;
}

}  // namespace

Terms counted(const TimedTick& tick) {
    const TickRecord& r = tick.record;
    return {1.0,
            tick.level_balls - 1.0,
            double(r.cells),
            double(r.triangles),
            double(r.tests),
            double(r.iterations),
            double(r.balls),
            double(r.mapping_cells),
            double(r.tests) * (1.0 - 1.0 / tick.level_balls)};
}

double CostPrices::cost_ns(const TimedTick& tick) const {
    const Work work = work_of(counted(tick), price_ns);
    return work.idle_ns + work.counted_ns * cache_factor(tick.level_bytes, cache_gain);
}

CostPrices fit_prices(std::span<const TimedTick> ticks) {
    CostPrices prices;
    Terms scale{};
    for (const TimedTick& tick : ticks) {
        const Terms terms = counted(tick);
        for (std::size_t j = 0; j < kTerms; ++j) scale[j] = std::max({scale[j], terms[j], 1.0});
    }
    std::vector<double> weight(ticks.size());
    for (std::size_t i = 0; i < ticks.size(); ++i) {
        weight[i] = 1.0 / std::max(double{ticks[i].record.cost_ns}, kFloor_ns);
    }
    Terms solution{};
    for (int round = 0; round < kRounds; ++round) {
        std::array<Terms, kTerms> gram{};
        Terms right{};
        for (std::size_t i = 0; i < ticks.size(); ++i) {
            Terms row = counted(ticks[i]);
            const double factor = cache_factor(ticks[i].level_bytes, prices.cache_gain);
            for (std::size_t j = 0; j < kTerms; ++j) row[j] *= weight[i] * (j < kIdleTerms ? 1.0 : factor) / scale[j];
            for (std::size_t j = 0; j < kTerms; ++j) {
                right[j] += row[j] * weight[i] * double{ticks[i].record.cost_ns};
                for (std::size_t k = 0; k < kTerms; ++k) gram[j][k] += row[j] * row[k];
            }
        }
        solution = non_negative(gram, right, solution);
        for (std::size_t j = 0; j < kTerms; ++j) prices.price_ns[j] = solution[j] / scale[j];
        // Ticks that are far off count little (Geman and McClure): interrupts are nobody's price.
        double slope2 = 0.0, slope_rest = 0.0;
        for (std::size_t i = 0; i < ticks.size(); ++i) {
            const double cost = double{ticks[i].record.cost_ns};
            const double fitted = std::max(prices.cost_ns(ticks[i]), kFloor_ns);
            const double error = (cost - fitted) / fitted;
            weight[i] = 1.0 / (fitted * (1.0 + (error / kScale) * (error / kScale)));
            const Work work = work_of(counted(ticks[i]), prices.price_ns);
            const double slope = work.counted_ns * (cache_factor(ticks[i].level_bytes, 1.0) - 1.0) * weight[i];
            slope2 += slope * slope;
            slope_rest += slope * (cost - work.idle_ns - work.counted_ns) * weight[i];
        }
        prices.cache_gain = slope2 > 0.0 ? std::max(0.0, slope_rest / slope2) : 0.0;
    }
    std::vector<std::pair<double, double>> by_fit;  // (fitted, measured over fitted)
    for (const TimedTick& tick : ticks) {
        const double fitted = std::max(prices.cost_ns(tick), 1.0);
        by_fit.emplace_back(fitted, double{tick.record.cost_ns} / fitted);
    }
    std::sort(by_fit.begin(), by_fit.end());
    std::vector<double> tail;  // the tail of cheap ticks threatens no budget
    for (std::size_t i = by_fit.size() * 9 / 10; i < by_fit.size(); ++i) tail.push_back(by_fit[i].second);
    prices.tail_p99 = std::max(1.0, quantile(tail, 0.99));
    prices.tail_p999 = std::max(1.0, quantile(tail, 0.999));
    return prices;
}

Agreement compare(const CostPrices& prices, std::span<const TimedTick> ticks) {
    std::vector<double> predicted, measured, off;
    for (const TimedTick& tick : ticks) {
        predicted.push_back(prices.cost_ns(tick));
        measured.push_back(std::max(1.0, double{tick.record.cost_ns}));
        off.push_back(std::abs(predicted.back() / measured.back() - 1.0));
    }
    const auto sum = [](const std::vector<double>& values) { return std::reduce(values.begin(), values.end()); };
    return {sum(predicted) / sum(measured), quantile(predicted, 0.999) / quantile(measured, 0.999), quantile(off, 0.5)};
}

}  // namespace hapticlod::station
