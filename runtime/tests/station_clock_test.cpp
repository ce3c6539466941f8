// Deadlines, and what is added up about them.
#include <gtest/gtest.h>

#include <limits>

#include "station/clock.hpp"
#include "station/histogram.hpp"

namespace hapticlod::station {
namespace {

TEST(Schedule, NeverDriftsAtRatesThatAreNoWholeNanoseconds) {
    Schedule schedule(1000, 1.0 / 3000.0);
    for (int i = 0; i < 2999; ++i) EXPECT_EQ(schedule.advance(0), 0u);
    EXPECT_EQ(schedule.deadline_ns(), 1000 + 1'000'000'000);
    EXPECT_EQ(schedule.advance(schedule.deadline_ns() + 1'000'000), 3u);  // 3.0 periods late: 3 left out
}

TEST(MonotonicClock, SleepsUntilItsDeadline) {
    MonotonicClock clock;
    const std::int64_t deadline = clock.now_ns() + 3'000'000;
    clock.sleep_until(deadline);
    EXPECT_GE(clock.now_ns(), deadline);
    clock.sleep_until(deadline);  // passed: at once
}

TEST(Histogram, PercentilesAreExactBelowAQuarterMicrosecondAndWithinOnePercentAbove) {
    Histogram histogram;
    EXPECT_EQ(histogram.percentile_us(0.5), 0.0);
    for (int i = 1; i <= 200; ++i) histogram.record(i);
    EXPECT_DOUBLE_EQ(histogram.percentile_us(0.5), 0.1);
    EXPECT_DOUBLE_EQ(histogram.percentile_us(0.99), 0.198);
    EXPECT_DOUBLE_EQ(histogram.mean_us(), 0.1005);
    for (std::int64_t value = 1; value < (std::int64_t{1} << 62); value = value * 3 + 1) {
        Histogram one;
        one.record(value);
        one.record(std::numeric_limits<std::int64_t>::max());
        const double exact = static_cast<double>(value) * 1e-3;
        EXPECT_GE(one.percentile_us(0.5), exact * (1.0 - 1e-12));
        EXPECT_LE(one.percentile_us(0.5), exact * 1.008);
    }
    histogram.record(-5);  // a clock that went backwards
    EXPECT_EQ(histogram.percentile_us(0.0), 0.0);
}

}  // namespace
}  // namespace hapticlod::station
