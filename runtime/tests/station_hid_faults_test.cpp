// The fault table (runtime/station/safety.hpp), row by row: loop, safety core, driver and the real hidapi against a
// virtual device, in simulated time.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "bundle_maker.hpp"
#include "station/hid_device.hpp"
#include "station/loop.hpp"
#include "virtual_hid.hpp"

namespace hapticlod::station {

// For googletest's messages.
inline void PrintTo(State state, std::ostream* out) { *out << name_of(state); }
inline void PrintTo(SafetyFault fault, std::ostream* out) { *out << name_of(fault); }

namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

DeviceProfile native() {
    auto profile = read_device_profile(HAPTICLOD_REPOSITORY "/configs/devices/native.toml");
    if (!profile) throw std::runtime_error(profile.fault().line());
    return profile.value();
}

// A loop around a virtual device. Each period: the firmware takes the force of the last one, a script changes what it
// likes, the firmware reports. The hand presses half a millimetre into a plate of 1 N/mm, from 0.1 s on.
class Bench : public LoopClock {
public:
    using Script = std::function<void(Bench&, int period)>;

    explicit Bench(Script with = {}, DeviceProfile described = native(), float coarse_z_mm = 0.0f)
        : profile(std::move(described)), script(std::move(with)) {
        const auto entry = find_device(profile, "", "");
        EXPECT_TRUE(entry) << entry.fault().line();
        auto opened = HidDevice::open(profile, entry.value(), {0.0, 0.0, 20.0});
        EXPECT_TRUE(opened) << opened.fault().line();
        device = std::move(opened).value();
        storage.push_back(test::plate(6, 1.5));
        storage.push_back(test::plate(3, 3.0, coarse_z_mm));
        views = {storage[0].view(), storage[1].view()};
        EXPECT_EQ(renderer.load(config, views, std::vector<BallData>(1)), "");
    }

    // Loop periods, at 1 kHz.
    void run(std::uint64_t periods) {
        safety.arm();
        (void)run_loop(renderer, *device, safety, *this, {1e-3, config.budget_us, periods, 2}, stop, tally);
        if (reading) device->flush(20.0);
        take_forces(false);
    }

    std::int64_t now_ns() noexcept override { return now; }
    bool real() const noexcept override { return costs_count; }
    void sleep_until(std::int64_t deadline_ns) noexcept override {
        now = std::max(now, deadline_ns) + late_ns;
        if (reading && period > 0) take_forces(true);
        force_of_period.push_back(firmware.force());
        ++period;
        const double press_mm = std::clamp(period - 100, 0, 50) * 0.01;
        firmware.position_mm[0] = 0.3f;
        firmware.position_mm[2] = static_cast<float>(0.2 - (period < 100 ? 0.0 : 0.2) - press_mm);
        firmware.step();
        if (script) script(*this, period);
        if (sending) node.send(raw.empty() ? firmware.report() : raw);
    }
    // Exactly the one force of the last period, however long its writer needs, or what there is.
    void take_forces(bool exactly_one) {
        while (const auto report = node.receive(exactly_one ? 20.0 : 0.0)) {
            firmware.take(*report);
            if (exactly_one) return;
        }
    }
    [[nodiscard]] double force_at(int at) const { return force_of_period.at(static_cast<std::size_t>(at)); }

    test::ShimFolder folder;
    test::VirtualNode node{folder, "hidraw0", "SIM1"};
    test::Firmware firmware;
    bool sending = true, reading = true;
    bool costs_count = false;  // what computing took, by a real clock
    std::int64_t late_ns = 0;  // every wake-up
    test::Report raw;          // sent in place of the firmware's report, where not empty
    DeviceProfile profile;
    Script script;
    std::unique_ptr<HidDevice> device;
    ConfigData config = [] {
        ConfigData plate = test::plate_config();
        plate.max_force_n = 20.0;  // it is the safety core that limits
        plate.blend_s = 0.0;       // a level switch is a step
        plate.l_in_mm = plate.l_out_mm = plate.closest_bound_mm = 3.0;
        return plate;
    }();
    std::vector<LevelStorage> storage;
    std::vector<LevelView> views;
    Renderer renderer;
    static constexpr SafetyLimits kLimits{1e-3, 500.0, 4.0, 500.0, 2000.0, 0.02, 0.0, 1e-3, 0.5};
    SafetyCore safety{kLimits};
    std::atomic<bool> stop{false};
    Tally tally;
    std::int64_t now = 0;
    int period = 0;
    std::vector<double> force_of_period;  // what the firmware applied, by period
};

TEST(HidFaults, WithoutAFaultTheForceArrivesChecked) {
    Bench bench;
    bench.run(400);
    EXPECT_EQ(bench.safety.state(), State::run);
    EXPECT_NEAR(bench.force_at(390), 0.5, 2e-3);  // 0.5 mm at 1 N/mm
    EXPECT_EQ(bench.firmware.bad_checksums, 0u);
    EXPECT_GE(bench.firmware.forces, 400u);  // one per period, and the zero, which may overtake the last of them
    EXPECT_EQ(bench.firmware.force(), 0.0);
    EXPECT_FALSE(bench.firmware.enabled);
    EXPECT_EQ(bench.firmware.watchdog_ms, 20u);
    EXPECT_EQ(bench.safety.counts().reports_lost, 0u);
    EXPECT_EQ(bench.tally.ticks_without_report, 0u);
    EXPECT_GT(bench.device->round_trip().count(), 390u);  // echo_seq tells
}

TEST(HidFaults, NoReportFadesTheForceAndIsSafeAfterTwentyMilliseconds) {
    Bench bench([](Bench& b, int period) { b.sending = period < 300; });
    bench.run(1000);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::no_report);
    EXPECT_NEAR(bench.force_at(300), 0.5, 1e-2);
    EXPECT_NEAR(bench.force_at(304), 0.5, 1e-2);  // 5 ms are nothing
    EXPECT_LT(bench.force_at(308), 0.45);         // then it fades
    EXPECT_EQ(bench.force_at(310), 0.0);          // 10 ms after the last report
    EXPECT_EQ(bench.period, 319);                 // SAFE at 20 ms
    EXPECT_EQ(bench.safety.counts().silences, 1u);
}

TEST(HidFaults, ShortSilenceIsPutUpWith) {
    Bench bench([](Bench& b, int period) { b.sending = period < 300 || period >= 312; });
    bench.run(1100);
    EXPECT_EQ(bench.force_at(311), 0.0);
    EXPECT_NEAR(bench.force_at(330), 0.5, 1e-2);
    EXPECT_EQ(bench.safety.state(), State::run);
    EXPECT_EQ(bench.safety.counts().silences, 1u);
    EXPECT_EQ(bench.safety.counts().reports_lost, 12u);
    EXPECT_GT(bench.safety.counts().degraded_ticks, 400u);
}

TEST(HidFaults, FrozenDeviceIsSafe) {
    Bench bench([](Bench& b, int period) {
        if (period >= 300) b.firmware.seq = 300, b.firmware.t_us = 300'000;
    });
    bench.run(1000);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::frozen);
    EXPECT_EQ(bench.period, 300 + static_cast<int>(SafetyCore::kFrozen));
    EXPECT_EQ(bench.firmware.force(), 0.0);
}

TEST(HidFaults, StillHandOfADeviceWithoutSequenceIsNoFault) {
    DeviceProfile profile = native();
    profile.inputs[0].fields[static_cast<std::size_t>(FieldName::seq)].reset();
    profile.inputs[0].fields[static_cast<std::size_t>(FieldName::t_us)].reset();
    Bench bench([](Bench& b, int) { b.firmware.position_mm[2] = 0.2f; }, profile);
    bench.run(500);
    EXPECT_EQ(bench.safety.state(), State::run);
}

TEST(HidFaults, LostReportsDegrade) {
    Bench bench([](Bench& b, int period) { b.sending = period < 200 || period % 10 != 0; });  // one in ten
    bench.run(900);
    EXPECT_EQ(bench.safety.state(), State::degraded);
    EXPECT_EQ(bench.safety.counts().reports_lost, 70u);
    EXPECT_NEAR(bench.force_at(880), 0.5, 1e-2);

    bench.device.reset();                                                                   // one station per device
    Bench few([](Bench& b, int period) { b.sending = period < 200 || period % 50 != 0; });  // 2 %
    few.run(900);
    EXPECT_EQ(few.safety.state(), State::run);
    EXPECT_EQ(few.safety.counts().degraded_ticks, 0u);
}

TEST(HidFaults, LostReportsAreNoSpeed) {
    // The hand slides at 15 mm/s; every second report is lost. By a clock that counts reports it would be 30.
    Bench bench([](Bench& b, int period) {
        b.firmware.position_mm[0] = static_cast<float>(0.3 + 0.015 * std::max(0, period - 200));
        b.sending = period < 200 || period % 2 == 0;
        if (period == 290) b.tally = Tally{};  // touching down was faster
    });
    bench.run(500);
    EXPECT_EQ(bench.safety.state(), State::degraded);
    EXPECT_NEAR(bench.tally.max_speed_mm_s, 15.0, 0.5);
    EXPECT_EQ(bench.tally.switches, 0u);  // the coarse level begins at 22 mm/s
}

TEST(HidFaults, BacklogGivesTheNewestAndNoForceStep) {
    // For 9 ms nothing, then all of it at once; the hand has moved on by 0.4 mm.
    Bench bench([](Bench& b, int period) {
        if (period > 300) b.firmware.position_mm[2] -= 0.4f;
        if (period == 308) {
            const std::uint32_t seq = b.firmware.seq;
            for (std::uint32_t i = 0; i < 8; ++i) {
                b.firmware.seq = seq - 8 + i;
                b.node.send(b.firmware.report());
            }
            b.firmware.seq = seq;
        }
        b.sending = period <= 299 || period >= 308;
    });
    bench.run(500);
    EXPECT_EQ(bench.safety.counts().backlogs, 1u);
    EXPECT_EQ(bench.safety.counts().reports_lost, 0u);
    EXPECT_NEAR(bench.force_at(490), 0.9, 1e-2);
    for (int i = 308; i < 400; ++i) EXPECT_LE(bench.force_at(i) - bench.force_at(i - 1), 0.5 + 1e-6) << i;  // 500 N/s
}

TEST(HidFaults, UnplugIsSafeAndTheDeviceCanBeOpenedAgain) {
    Bench bench([](Bench& b, int period) {
        if (period == 300) b.node.unplug(), b.sending = b.reading = false;
    });
    bench.run(1000);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::unplugged);
    EXPECT_EQ(bench.period, 300);
    EXPECT_FALSE(find_device(bench.profile, "", "SIM1"));
    bench.device.reset();
    bench.node.plug("SIM1");
    const auto entry = find_device(bench.profile, "", "SIM1");
    ASSERT_TRUE(entry);
    EXPECT_TRUE(HidDevice::open(bench.profile, entry.value(), {0, 0, 0}));
}

TEST(HidFaults, PositionThatIsNotFiniteIsHeldTwiceThenSafe) {
    Bench bench([](Bench& b, int period) {
        if (period == 300 || period == 301 || period >= 400)
            b.firmware.position_mm[1] = kNan;
        else
            b.firmware.position_mm[1] = 0.0f;
    });
    bench.run(1000);
    EXPECT_NEAR(bench.force_at(302), 0.5, 1e-2);
    EXPECT_NEAR(bench.force_at(390), 0.5, 1e-2);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::position_not_finite);
    EXPECT_EQ(bench.period, 402);
    EXPECT_EQ(bench.safety.counts().positions_not_finite, 5u);
}

TEST(HidFaults, PositionJumpIsRejectedThenSafe) {
    Bench bench([](Bench& b, int period) {
        if (period == 300 || period == 301 || period >= 400) b.firmware.position_mm[2] -= 8.0f;  // 8000 mm/s
    });
    bench.run(1000);
    for (int i = 300; i < 400; ++i) EXPECT_NEAR(bench.force_at(i), 0.5, 1e-2) << i;
    EXPECT_EQ(bench.safety.fault(), SafetyFault::position_jump);
    EXPECT_EQ(bench.period, 402);
}

TEST(HidFaults, ForceLimitsHoldAtTheDevice) {
    Bench bench([](Bench& b, int period) {
        if (period > 200)
            b.firmware.position_mm[2] -= static_cast<float>(std::min(period - 200, 60)) * 0.1f;  // 6 mm in
    });
    bench.run(400);
    EXPECT_NEAR(bench.force_at(390), 4.0, 1e-5);  // of 6.5 N
    EXPECT_GT(bench.safety.counts().forces_clamped, 100u);
    for (std::size_t i = 1; i < bench.force_of_period.size(); ++i) {
        EXPECT_LE(bench.force_of_period[i] - bench.force_of_period[i - 1], 0.5 + 1e-6);
    }
}

TEST(HidFaults, LevelSwitchMakesNoForceStep) {
    // The coarse plate is 1.5 mm higher, and a hand at 60 mm/s changes to it: 2 N after 0.5 N.
    std::uint64_t before = 0;
    Bench bench(
        [&before](Bench& b, int period) {
            b.firmware.position_mm[0] = static_cast<float>(0.3 + 0.06 * std::clamp(period - 300, 0, 60));
            if (period != 290) return;
            b.tally = Tally{};  // touching down was fast, too
            before = b.safety.counts().forces_slewed;
        },
        native(), 1.5f);
    bench.run(355);
    EXPECT_EQ(bench.tally.switches, 1u);
    EXPECT_NEAR(bench.force_at(300), 0.5, 1e-2);
    EXPECT_NEAR(bench.force_at(354), 2.0, 1e-2);
    EXPECT_GE(bench.safety.counts().forces_slewed - before, 2u);  // 1.5 N, of which each tick may have 0.5
    for (std::size_t i = 1; i < bench.force_of_period.size(); ++i) {
        EXPECT_LE(bench.force_of_period[i] - bench.force_of_period[i - 1], 0.5 + 1e-6) << i;
    }
}

TEST(HidFaults, ForceThatIsNotFiniteSendsZeroAndIsSafe) {
    const double broken[3] = {0.0, kNan, 0.5};
    double sent[3];
    Bench bench;
    bench.run(300);  // ends with a force of 0, and the core still in RUN
    ASSERT_EQ(bench.safety.state(), State::run);
    bench.firmware.force_n[2] = 1.0f;
    bench.safety.gate(broken, 1e-3, sent);
    bench.device->write(bench.now, sent, bench.safety.live());
    bench.device->flush(20.0);
    bench.take_forces(false);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::force_not_finite);
    EXPECT_EQ(bench.firmware.force(), 0.0);
    EXPECT_FALSE(bench.firmware.enabled);

    // And if one came as far as the driver: it is not packed.
    bench.firmware.force_n[2] = 1.0f;
    bench.device->write(bench.now, broken, true);
    bench.device->flush(20.0);
    bench.take_forces(false);
    EXPECT_EQ(bench.firmware.force(), 0.0);
}

TEST(HidFaults, TicksOverBudgetGoCoarserThenSafe) {
    Bench bench;
    SafetyLimits impossible = Bench::kLimits;
    bench.config.budget_us = impossible.budget_us = 1e-3;  // nothing is that fast
    bench.safety = SafetyCore(impossible);
    bench.costs_count = true;
    bench.run(1000);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::overruns);
    EXPECT_EQ(bench.tally.level_ticks[0], 1u);  // the first; coarser from the second on
    EXPECT_EQ(bench.tally.level_ticks[1], SafetyCore::kOverruns - 1u);
    EXPECT_EQ(bench.safety.counts().over_budget, SafetyCore::kOverruns);
    EXPECT_EQ(bench.firmware.force(), 0.0);
}

TEST(HidFaults, LatePeriodsAreCountedThenSafe) {
    Bench bench([](Bench& b, int period) {
        b.late_ns = period >= 300 ? 2'500'000 : 0;
        if (period == 290) b.tally = Tally{};
    });
    bench.run(1000);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::overruns);
    EXPECT_EQ(bench.safety.counts().late_periods, SafetyCore::kOverruns);
    EXPECT_EQ(bench.safety.counts().over_budget, 0u);
    EXPECT_EQ(bench.tally.switches, 0u);  // a level that computes less would not have woken up earlier
    EXPECT_EQ(bench.firmware.force(), 0.0);
}

TEST(HidFaults, BlockedWriteIsSafe) {
    Bench bench([](Bench& b, int period) {
        if (period == 300) b.reading = false;  // the device stops taking reports; it still sends
        if (period > 300) ::usleep(100);       // lets the writer run into it
        b.firmware.watchdog_ms = 0;            // and its watchdog says nothing
    });
    bench.run(100'000);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::write_blocked);
    EXPECT_GT(bench.period, 318);
}

TEST(HidFaults, StatusBitsOfTheDeviceAreSafe) {
    const std::pair<int, SafetyFault> bits[] = {
        {1, SafetyFault::device_fault}, {2, SafetyFault::device_estop}, {3, SafetyFault::device_watchdog}};
    for (const auto& [bit, fault] : bits) {
        Bench bench([bit = bit](Bench& b, int period) {
            if (period == 300) b.firmware.status = static_cast<std::uint16_t>(b.firmware.status | (1 << bit));
        });
        bench.run(1000);
        EXPECT_EQ(bench.safety.fault(), fault);
        EXPECT_EQ(bench.period, 300);
        EXPECT_EQ(bench.firmware.force(), 0.0);
    }
}

TEST(HidFaults, OperatorsStopIsSafe) {
    std::atomic<bool> emergency{false};
    Bench bench([&emergency](Bench&, int period) { emergency = period >= 300; });
    bench.safety.arm();
    (void)run_loop(bench.renderer, *bench.device, bench.safety, bench, {1e-3, 500.0, 1000, 2, &emergency}, bench.stop,
                   bench.tally);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::operator_stop);
    EXPECT_EQ(bench.period, 300);
}

TEST(HidFaults, DeviceThatIsNotCalibratedIsNotRun) {
    Bench bench([](Bench& b, int period) { b.firmware.status = period < 300 ? 0 : 1 << 4; });
    bench.run(290);
    EXPECT_EQ(bench.safety.state(), State::armed);
    EXPECT_EQ(bench.safety.counts().uncalibrated, 290u);
    for (const double force : bench.force_of_period) EXPECT_EQ(force, 0.0);
    bench.device.reset();  // one station per device
    Bench later([](Bench& b, int period) { b.firmware.status = period < 300 ? 0 : 1 << 4; });
    later.run(400);
    EXPECT_EQ(later.safety.state(), State::run);
}

TEST(HidFaults, DeviceOfOtherIdsOrUsageIsNotFound) {
    const test::ShimFolder folder;
    const test::VirtualNode node(folder, "hidraw0", "SIM1");
    DeviceProfile profile = native();
    EXPECT_TRUE(find_device(profile, "", ""));
    profile.match.product_id ^= 1;
    EXPECT_FALSE(find_device(profile, "", ""));
    profile = native();
    profile.match.usage = 2;
    const auto other = find_device(profile, "", "");
    ASSERT_FALSE(other);
    EXPECT_NE(other.fault().line().find("no device 1209:0001"), std::string::npos);
    profile = native();
    profile.match.usage_page = 0xFFAB;
    EXPECT_FALSE(find_device(profile, "", ""));
}

TEST(HidFaults, ReportOfAnotherLengthIsRefused) {
    Bench bench([](Bench& b, int) { b.raw = test::Report(14, 0); });
    bench.run(1000);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::wrong_report);
    EXPECT_EQ(bench.period, 1);
}

TEST(HidFaults, DeviceThatNeverSpeaksIsRefusedAfterItsTime) {
    Bench bench([](Bench& b, int) { b.sending = false; });
    bench.run(2000);
    EXPECT_EQ(bench.safety.fault(), SafetyFault::no_report);
    EXPECT_NEAR(bench.period, 501, 1);
}

TEST(HidFaults, FirmwareWatchdogLetsGoWhenNobodyWrites) {
    Bench bench;
    bench.run(300);
    bench.firmware.force_n[2] = 1.0f;  // as if the last force had stayed
    for (int i = 0; i < 20; ++i) bench.firmware.step();
    EXPECT_EQ(bench.firmware.force(), 1.0);
    bench.firmware.step();
    EXPECT_EQ(bench.firmware.force(), 0.0);
    EXPECT_NE(bench.firmware.status & (1 << 3), 0);
}

}  // namespace
}  // namespace hapticlod::station
