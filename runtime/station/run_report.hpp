// What a run says at its end: a table for people, one line of JSON for programs.
#pragma once
#include <optional>
#include <string>

#include "core/layout.hpp"
#include "io/trust.hpp"
#include "station/device.hpp"
#include "station/histogram.hpp"
#include "station/loop.hpp"
#include "station/realtime.hpp"
#include "station/safety.hpp"
#include "station/tally.hpp"

namespace hapticlod::station {

struct RunReport {
    std::string bundle;
    TrustVerdict trust;
    bool checked_before;  // its large arrays were found right at an earlier start
    std::string motion;   // where the simulated hand's path came from
    DeviceTraits device;
    ConfigData config;  // as it was run
    double bundle_stiffness_n_mm;
    double stiffness_limit_n_mm;  // of the device, at this rate
    bool virtual_time;
    bool stopped_by_signal;
    RealTimeRights rights;
    LoopOutcome outcome;
    State state;
    SafetyFault fault;
    SafetyCounts safety;
    const Tally& tally;
    const Histogram* round_trip = nullptr;  // of forces, where the device tells
    std::string flight_recording;           // its path; empty: none was written
};

[[nodiscard]] std::string report_text(const RunReport& report);
[[nodiscard]] std::string report_json(const RunReport& report);

}  // namespace hapticlod::station
