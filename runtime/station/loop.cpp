#include "station/loop.hpp"

#include <algorithm>
#include <limits>

#include "station/overrun.hpp"

namespace hapticlod::station {
namespace {

std::uint16_t saturated(std::uint32_t value) {
    return static_cast<std::uint16_t>(std::min<std::uint32_t>(value, std::numeric_limits<std::uint16_t>::max()));
}

TelemetryFrame frame_of(std::int64_t wake_ns, std::int64_t late_ns, const DeviceReading& reading, const Pose& pose,
                        const TickRecord& record, const double sent_n[3], const SafetyCore& safety) {
    TelemetryFrame frame{};
    frame.now_ns = wake_ns;
    frame.device_s = reading.time_s;
    std::copy_n(pose.position_mm, 3, frame.position_mm);
    std::copy_n(record.scp_mm, 3, frame.scp_mm);
    for (int i = 0; i < 4; ++i) frame.orientation[i] = static_cast<float>(pose.orientation[i]);
    for (int i = 0; i < 3; ++i) frame.force_n[i] = static_cast<float>(sent_n[i]);
    frame.speed_mm_s = record.speed_mm_s;
    frame.cost_us = 1e-3f * record.cost_ns;
    frame.wake_up_us = 1e-3f * static_cast<float>(late_ns);
    frame.energy_out_mj = static_cast<float>(safety.energy_out_mj());
    frame.tick_errors = record.errors;
    frame.device_status = reading.link.status;
    frame.drained = saturated(reading.link.drained);
    frame.lost = saturated(reading.link.lost);
    frame.buttons = saturated(reading.link.buttons);
    frame.level = record.level;
    frame.contact = record.contact;
    frame.mapping = record.mapping;
    frame.state = static_cast<std::uint8_t>(safety.state());
    frame.fault = static_cast<std::uint8_t>(safety.fault());
    frame.fresh = reading.link.fresh ? 1 : 0;
    return frame;
}

}  // namespace

LoopOutcome run_loop(Renderer& renderer, Device& device, SafetyCore& safety, LoopClock& clock,
                     const LoopSettings& settings, const std::atomic<bool>& stop, Tally& tally) noexcept {
    constexpr double kZero[3] = {0.0, 0.0, 0.0};
    MonotonicClock stopwatch;  // measures computing even where the loop's own time is simulated
    OverrunGovernor governor(settings.level_count, settings.period_s);
    LoopOutcome outcome;
    const std::int64_t start_ns = clock.now_ns();
    Schedule schedule(start_ns, settings.period_s);
    std::int64_t last_ns = start_ns;
    TickRecord record{};
    Pose pose{};

    while (settings.periods == 0 || schedule.index() <= settings.periods) {
        const std::int64_t deadline_ns = schedule.deadline_ns();
        clock.sleep_until(deadline_ns);
        if (stop.load(std::memory_order_relaxed)) break;
        const std::int64_t wake_ns = clock.now_ns();
        const double since_last_s = static_cast<double>(wake_ns - last_ns) * 1e-9;
        last_ns = wake_ns;
        tally.wake_up.record(wake_ns - deadline_ns);

        const DeviceReading reading = device.read(wake_ns);
        if (settings.emergency != nullptr && settings.emergency->load(std::memory_order_relaxed)) {
            safety.emergency_stop();
        }
        safety.link(reading.link, since_last_s);
        bool over_budget = false;
        if (reading.link.fresh) {
            pose = safety.accept(reading);
            if (settings.scene != nullptr) settings.scene->apply(renderer);
            const std::int64_t before_ns = stopwatch.now_ns();
            renderer.tick(pose, reading.time_s, record);
            record.cost_ns = static_cast<float>(stopwatch.now_ns() - before_ns);
            // In simulated time nothing measured may change the outcome: such a run is repeatable.
            const double cost_us = clock.real() ? static_cast<double>(record.cost_ns) * 1e-3 : 0.0;
            over_budget = cost_us > settings.budget_us;
            safety.timing(cost_us, since_last_s);
            renderer.set_coarsest_floor(governor.update(over_budget, record.level));
        } else {
            record.cost_ns = 0.0f;
            safety.timing(0.0, since_last_s);
        }

        double force_n[3];
        safety.gate(record.force_n, since_last_s, force_n);
        device.write(wake_ns, force_n, safety.live());
        if (reading.link.fresh) {
            tally.add(record, force_n, over_budget);
        } else {
            ++tally.ticks_without_report;
        }
        if (settings.telemetry != nullptr) {
            settings.telemetry->push(frame_of(wake_ns, wake_ns - deadline_ns, reading, pose, record, force_n, safety));
        }
        if (safety.state() == State::safe) break;
        const std::uint64_t left = settings.periods == 0 ? UINT64_MAX : settings.periods - schedule.index();
        tally.skipped += std::min(left, schedule.advance(clock.now_ns()));
    }
    const std::int64_t end_ns = clock.now_ns();
    device.write(end_ns, kZero, false);
    renderer.reset();
    outcome.coarser_by_overrun = governor.raised();
    outcome.elapsed_s = static_cast<double>(end_ns - start_ns) * 1e-9;
    return outcome;
}

}  // namespace hapticlod::station
