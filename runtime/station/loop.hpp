// The real-time loop: device -> safety -> tick -> safety -> device, once per period.
#pragma once
#include <atomic>
#include <cstdint>

#include "core/renderer.hpp"
#include "station/clock.hpp"
#include "station/device.hpp"
#include "station/safety.hpp"
#include "station/scene_control.hpp"
#include "station/tally.hpp"
#include "station/telemetry.hpp"

namespace hapticlod::station {

struct LoopSettings {
    double period_s;
    double budget_us;
    std::uint64_t periods;  // how long to run, ticks that were left out included; 0: until stopped
    std::uint32_t level_count;
    const std::atomic<bool>* emergency = nullptr;  // set by the operator's stop
    TelemetryRing* telemetry = nullptr;            // told every tick
    SceneControl* scene = nullptr;                 // asked before every tick which parts there are
};

struct LoopOutcome {
    std::uint64_t coarser_by_overrun = 0;  // how often an overrun raised the coarsest floor
    double elapsed_s = 0.0;
};

// Runs until the periods are over, `stop` is set, or the safety core is SAFE; the device's last force is 0. The
// renderer must be loaded and the safety core armed. Allocates nothing, logs nothing. Without a new report nothing is
// rendered: the force is the last one, which the safety core fades.
LoopOutcome run_loop(Renderer& renderer, Device& device, SafetyCore& safety, LoopClock& clock,
                     const LoopSettings& settings, const std::atomic<bool>& stop, Tally& tally) noexcept;

}  // namespace hapticlod::station
