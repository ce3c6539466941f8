#include "station/loop.hpp"

#include <algorithm>

#include "station/overrun.hpp"

namespace hapticlod::station {

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

    while (settings.periods == 0 || schedule.index() <= settings.periods) {
        const std::int64_t deadline_ns = schedule.deadline_ns();
        clock.sleep_until(deadline_ns);
        if (stop.load(std::memory_order_relaxed)) break;
        const std::int64_t wake_ns = clock.now_ns();
        const double since_last_s = static_cast<double>(wake_ns - last_ns) * 1e-9;
        last_ns = wake_ns;
        tally.wake_up.record(wake_ns - deadline_ns);

        const DeviceReading reading = device.read(wake_ns);
        const Pose pose = safety.accept(reading);
        const std::int64_t before_ns = stopwatch.now_ns();
        renderer.tick(pose, reading.time_s, record);
        record.cost_ns = static_cast<float>(stopwatch.now_ns() - before_ns);

        // In simulated time nothing measured may change the outcome: such a run is repeatable.
        const double cost_us = clock.real() ? static_cast<double>(record.cost_ns) * 1e-3 : 0.0;
        const bool over_budget = cost_us > settings.budget_us;
        safety.timing(cost_us, since_last_s);
        renderer.set_coarsest_floor(governor.update(over_budget, record.level));

        double force_n[3];
        safety.gate(record.force_n, since_last_s, force_n);
        device.write(wake_ns, force_n);
        tally.add(record, force_n, over_budget);
        if (safety.state() == State::safe) break;
        const std::uint64_t left = settings.periods == 0 ? UINT64_MAX : settings.periods - schedule.index();
        tally.skipped += std::min(left, schedule.advance(clock.now_ns()));
    }
    const std::int64_t end_ns = clock.now_ns();
    device.write(end_ns, kZero);
    renderer.reset();
    outcome.coarser_by_overrun = governor.raised();
    outcome.elapsed_s = static_cast<double>(end_ns - start_ns) * 1e-9;
    return outcome;
}

}  // namespace hapticlod::station
