// The fit of prices on ticks whose prices are known, and the doctor on made-up machines.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <random>

#include "station/cost_fit.hpp"
#include "station/doctor.hpp"

namespace hapticlod::station {
namespace {

std::vector<TimedTick> priced(const CostPrices& prices, double noise, double interrupted) {
    std::mt19937 random(7);
    std::normal_distribution<double> normal;
    std::uniform_real_distribution<double> uniform;
    std::vector<TimedTick> ticks(8000);
    for (TimedTick& tick : ticks) {
        const auto count = [&](double most) { return static_cast<std::uint32_t>(std::pow(most, uniform(random))); };
        tick.record.cells = count(300);
        tick.record.triangles = count(20'000);
        tick.record.tests = count(3'000);
        tick.record.iterations = count(60);
        tick.level_balls = std::floor(std::pow(400.0, uniform(random)));
        tick.record.balls = static_cast<std::uint32_t>(tick.level_balls * uniform(random));
        tick.record.mapping_cells = uniform(random) < 0.05 ? count(200) : 0;
        tick.level_bytes = std::pow(10.0, 5.0 + 3.5 * uniform(random));
        double cost = prices.cost_ns(tick) * std::exp(noise * normal(random));
        if (uniform(random) < interrupted) cost += 2e6;
        tick.record.cost_ns = static_cast<float>(cost);
    }
    return ticks;
}

CostPrices known() {
    CostPrices prices;
    prices.price_ns = {300.0, 8.0, 40.0, 2.0, 55.0, 250.0, 12.0, 90.0, 20.0};
    prices.cache_gain = 0.6;
    return prices;
}

TEST(CostFit, FindsThePrices) {
    const CostPrices truth = known();
    const CostPrices fitted = fit_prices(priced(truth, 0.0, 0.0));
    for (std::size_t i = 0; i < kTerms; ++i)
        EXPECT_NEAR(fitted.price_ns[i] / truth.price_ns[i], 1.0, 0.02) << kPriceNames[i];
    EXPECT_NEAR(fitted.cache_gain, truth.cache_gain, 0.02);
    EXPECT_NEAR(fitted.tail_p999, 1.0, 0.02);
}

// The formula of hapticlod/station.py, by hand: 32 MB pay half of the gain, and only for what is counted.
TEST(CostFit, PricesCarriedBallsAndGoingFromBallToBall) {
    TimedTick tick{{}, 32e6, 4.0};
    tick.record.tests = 100;
    EXPECT_DOUBLE_EQ(known().cost_ns(tick), 300.0 + 3 * 8.0 + 100 * (55.0 + 0.75 * 20.0) * 1.3);
    tick.level_balls = 1.0;
    EXPECT_DOUBLE_EQ(known().cost_ns(tick), 300.0 + 100 * 55.0 * 1.3);
}

TEST(CostFit, InterruptsAreNobodysPrice) {
    const CostPrices truth = known();
    const auto noisy = priced(truth, 0.1, 0.02);
    const CostPrices fitted = fit_prices(noisy);
    double off = 0.0;
    for (const TimedTick& tick : noisy) off += std::abs(std::log(fitted.cost_ns(tick) / truth.cost_ns(tick)));
    EXPECT_LT(off / static_cast<double>(noisy.size()), 0.05);
    EXPECT_GT(fitted.tail_p99, 1.2);  // they are its tail
}

TEST(CostFit, PricesAreNeverNegative) {
    auto ticks = priced(known(), 0.3, 0.05);
    for (TimedTick& tick : ticks) tick.record.balls = 400 - std::min(400u, tick.record.tests);  // the dearer, the fewer
    for (const double price : fit_prices(ticks).price_ns) EXPECT_GE(price, 0.0);
}

struct Machine {
    Machine() {
        if (::mkdtemp(root.data()) == nullptr) throw std::runtime_error("no temporary folder");
        std::filesystem::create_directories(root + "/dev/shm");
    }
    ~Machine() { std::filesystem::remove_all(root); }
    void has(const std::string& path, const std::string& line) const {
        std::filesystem::create_directories(std::filesystem::path(root + path).parent_path());
        std::ofstream(root + path) << line << "\n";
    }
    [[nodiscard]] Finding on(const std::string& what) const {
        for (const Finding& finding : diagnose(root)) {
            if (finding.what == what) return finding;
        }
        return {what, Health::bad, "not looked at", ""};
    }
    std::string root = "/tmp/hapticlod-doctor-XXXXXX";
};

TEST(Doctor, TunedMachineIsGood) {
    const Machine machine;
    machine.has("/sys/kernel/realtime", "1");
    machine.has("/proc/cpuinfo", "flags\t\t: fpu vme tsc");
    machine.has("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance");
    machine.has("/sys/devices/system/cpu/isolated", "3");
    machine.has("/proc/sys/kernel/sched_rt_runtime_us", "-1");
    machine.has("/sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc");
    machine.has("/dev/hidraw0", "");
    for (const char* what : {"kernel", "machine", "processor clock", "isolated processor", "real-time throttling",
                             "clock source", "/dev/hidraw0"}) {
        const Finding finding = machine.on(what);
        EXPECT_EQ(finding.health, Health::good) << what << ": " << finding.found;
        EXPECT_EQ(finding.remedy, "") << what;
    }
}

TEST(Doctor, EveryComplaintHasItsRemedy) {
    const Machine machine;
    machine.has("/sys/kernel/realtime", "0");
    machine.has("/proc/cpuinfo", "flags\t\t: fpu hypervisor tsc");
    machine.has("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance");
    machine.has("/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "powersave");
    machine.has("/proc/sys/kernel/sched_rt_runtime_us", "950000");
    machine.has("/sys/devices/system/clocksource/clocksource0/current_clocksource", "hpet");
    for (const char* what :
         {"machine", "processor clock", "isolated processor", "real-time throttling", "clock source", "HID devices"}) {
        const Finding finding = machine.on(what);
        EXPECT_EQ(finding.health, Health::weak) << what << ": " << finding.found;
        EXPECT_NE(finding.remedy, "") << what;
    }
    EXPECT_NE(machine.on("processor clock").found.find("powersave"), std::string::npos);
}

}  // namespace
}  // namespace hapticlod::station
