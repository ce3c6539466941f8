#include "station/run_report.hpp"

#include <algorithm>
#include <cstdarg>
#include <cstdio>
#include <utility>

#include "io/json_text.hpp"

namespace hapticlod::station {
namespace {

constexpr std::pair<std::uint32_t, const char*> kErrorNames[] = {
    {kErrHipNotFinite, "hip_not_finite"},
    {kErrPeriod, "period"},
    {kErrHipJump, "hip_jump"},
    {kErrNotConverged, "not_converged"},
    {kErrCandidates, "candidates"},
    {kErrContactLost, "contact_lost"},
    {kErrForceClamped, "force_clamped"},
    {kErrSlewLimited, "slew_limited"},
    {kErrForceNotFinite, "force_not_finite"},
    {kErrStartInside, "start_inside"},
    {kErrTurnHeld, "turn_held"},
};

[[gnu::format(printf, 2, 3)]] void add(std::string& text, const char* format, ...) {
    char line[512];
    va_list values;
    va_start(values, format);
    std::vsnprintf(line, sizeof(line), format, values);
    va_end(values);
    text += line;
}

double share(std::uint64_t part, std::uint64_t whole) {
    return whole == 0 ? 0.0 : static_cast<double>(part) / static_cast<double>(whole);
}

std::uint64_t mapped(const Tally& tally, MappingOutcome outcome) {
    return tally.mappings[static_cast<std::size_t>(outcome)];
}

double level_speed(const Tally& tally, std::uint32_t level) {
    const std::uint64_t ticks = tally.level_ticks[level];
    return ticks == 0 ? 0.0 : tally.level_speed_sum_mm_s[level] / static_cast<double>(ticks);
}

void add_row(std::string& text, const char* name, const Histogram& h) {
    add(text, "  %-10s %9.2f %9.2f %9.2f %9.2f %9.2f\n", name, h.mean_us(), h.percentile_us(0.5), h.percentile_us(0.99),
        h.percentile_us(0.999), h.max_us());
}

void write_durations(JsonWriter& json, const std::string& name, const Histogram& h) {
    json.field(name + "_mean_us", h.mean_us());
    json.field(name + "_p50_us", h.percentile_us(0.5));
    json.field(name + "_p99_us", h.percentile_us(0.99));
    json.field(name + "_p999_us", h.percentile_us(0.999));
    json.field(name + "_max_us", h.max_us());
}

void write_levels(JsonWriter& json, const RunReport& report) {
    json.key("levels").open('[');
    for (std::uint32_t i = 0; i < report.config.level_count; ++i) {
        json.open('{')
            .field("level", i)
            .field("triangles", report.config.triangles[i])
            .field("ticks", report.tally.level_ticks[i])
            .field("share", share(report.tally.level_ticks[i], report.tally.ticks))
            .field("mean_speed_mm_s", level_speed(report.tally, i))
            .close();
    }
    json.close();
}

void write_safety(JsonWriter& json, const SafetyCounts& counts) {
    json.key("safety").open('{');
    json.field("positions_not_finite", counts.positions_not_finite);
    json.field("positions_rejected", counts.positions_rejected);
    json.field("forces_not_finite", counts.forces_not_finite);
    json.field("forces_clamped", counts.forces_clamped);
    json.field("forces_slewed", counts.forces_slewed);
    json.field("longest_overrun_run", counts.longest_overrun_run);
    json.field("degraded_ticks", counts.degraded_ticks);
    json.field("reports_lost", counts.reports_lost).field("backlogs", counts.backlogs);
    json.field("silences", counts.silences).field("longest_silence_ms", 1e3 * counts.longest_silence_s);
    json.field("uncalibrated_readings", counts.uncalibrated);
    json.field("most_energy_out_mj", counts.most_energy_out_mj).field("passivity_ticks", counts.passivity_ticks);
    json.close();
}

const char* stopped_by(const RunReport& report) {
    if (report.state == State::safe) return "fault";
    return report.stopped_by_signal ? "signal" : "time";
}

}  // namespace

std::string report_text(const RunReport& report) {
    const Tally& tally = report.tally;
    std::string text;
    text += report.bundle;  // of any length: not through the line buffer
    add(text, " on device %s: %.2f s at %g Hz, %llu ticks%s\n", std::string(report.device.name).c_str(),
        report.outcome.elapsed_s, report.config.loop_hz, static_cast<unsigned long long>(tally.ticks),
        report.virtual_time ? ", simulated time" : "");
    if (report.trust.trust != Trust::trusted) add(text, "  bundle %s\n", report.trust.text().c_str());
    add(text, "  us              mean       p50       p99     p99.9       max\n");
    add_row(text, "loop cost", tally.loop_cost);
    if (!report.virtual_time) add_row(text, "wake-up", tally.wake_up);
    if (report.round_trip != nullptr && report.round_trip->count() > 0) add_row(text, "round trip", *report.round_trip);
    for (std::uint32_t i = 0; i < report.config.level_count; ++i) {
        add(text, "  level %u: %u triangles, %.1f %% of ticks, mean speed %.1f mm/s\n", i, report.config.triangles[i],
            100.0 * share(tally.level_ticks[i], tally.ticks), level_speed(tally, i));
    }
    add(text, "  switches %llu (%.2f /s), mapping: %llu hit, %llu closest, %llu miss\n",
        static_cast<unsigned long long>(tally.switches),
        report.outcome.elapsed_s > 0.0 ? static_cast<double>(tally.switches) / report.outcome.elapsed_s : 0.0,
        static_cast<unsigned long long>(mapped(tally, MappingOutcome::hit)),
        static_cast<unsigned long long>(mapped(tally, MappingOutcome::closest)),
        static_cast<unsigned long long>(mapped(tally, MappingOutcome::miss)));
    add(text, "  in contact %.1f %% of ticks, force at most %.2f N, stiffness %.3g N/mm (device limit %.3g)\n",
        100.0 * share(tally.contact_ticks, tally.ticks), tally.max_force_n, report.config.stiffness_n_mm,
        report.stiffness_limit_n_mm);
    add(text, "  over budget %llu (longest run %llu, coarser %llu times), late periods %llu, ticks left out %llu\n",
        static_cast<unsigned long long>(report.safety.over_budget),
        static_cast<unsigned long long>(tally.longest_over_budget_run),
        static_cast<unsigned long long>(report.outcome.coarser_by_overrun),
        static_cast<unsigned long long>(report.safety.late_periods), static_cast<unsigned long long>(tally.skipped));
    if (tally.ticks_without_report > 0 || report.safety.reports_lost > 0) {
        add(text, "  ticks without a report %llu, reports lost %llu, longest silence %.1f ms\n",
            static_cast<unsigned long long>(tally.ticks_without_report),
            static_cast<unsigned long long>(report.safety.reports_lost), 1e3 * report.safety.longest_silence_s);
    }
    add(text, "  passivity: at most %.3g mJ given within one contact, damping added in %llu ticks\n",
        report.safety.most_energy_out_mj, static_cast<unsigned long long>(report.safety.passivity_ticks));
    add(text, "  ended %s, stopped by %s, fault: %s\n", name_of(report.state), stopped_by(report),
        name_of(report.fault));
    return text;
}

std::string report_json(const RunReport& report) {
    const Tally& tally = report.tally;
    const std::uint64_t hit = mapped(tally, MappingOutcome::hit), closest = mapped(tally, MappingOutcome::closest);
    const std::uint64_t miss = mapped(tally, MappingOutcome::miss);
    JsonWriter json;
    json.open('{');
    json.field("bundle", std::string_view(report.bundle));
    json.field("signature", std::string_view(report.trust.text()));
    json.field("trusted", report.trust.trust == Trust::trusted);
    json.field("checked_before", report.checked_before);
    json.field("device", report.device.name);
    json.field("motion", std::string_view(report.motion)).field("virtual_time", report.virtual_time);
    json.field("fifo", report.rights.fifo).field("memory_locked", report.rights.memory_locked);
    json.key("cpu");
    report.rights.cpu ? json.value(static_cast<std::uint32_t>(*report.rights.cpu)) : json.raw("null");
    json.field("loop_hz", report.config.loop_hz).field("budget_us", report.config.budget_us);
    json.field("seconds", report.outcome.elapsed_s).field("ticks", tally.ticks).field("skipped_ticks", tally.skipped);
    write_durations(json, "loop_cost", tally.loop_cost);
    write_durations(json, "wake_up", tally.wake_up);
    if (report.round_trip != nullptr) write_durations(json, "round_trip", *report.round_trip);
    json.field("ticks_without_report", tally.ticks_without_report);
    json.field("deadline_misses", report.safety.over_budget);
    json.field("deadline_miss_rate", share(report.safety.over_budget, tally.ticks));
    json.field("longest_miss_run", tally.longest_over_budget_run);
    json.field("late_periods", report.safety.late_periods);
    json.field("coarser_by_overrun", report.outcome.coarser_by_overrun);
    write_levels(json, report);
    json.field("switches", tally.switches);
    json.field("switches_per_s",
               report.outcome.elapsed_s > 0.0 ? static_cast<double>(tally.switches) / report.outcome.elapsed_s : 0.0);
    json.field("mapping_hit", hit).field("mapping_closest", closest).field("mapping_miss", miss);
    json.key("mapping_hit_rate");
    hit + closest + miss == 0 ? json.raw("null") : json.value(share(hit + closest, hit + closest + miss));
    json.field("contact_share", share(tally.contact_ticks, tally.ticks));
    json.field("max_force_n", tally.max_force_n).field("max_speed_mm_s", tally.max_speed_mm_s);
    json.field("stiffness_n_mm", report.config.stiffness_n_mm);
    json.field("bundle_stiffness_n_mm", report.bundle_stiffness_n_mm);
    json.field("stiffness_limit_n_mm", report.stiffness_limit_n_mm);
    write_safety(json, report.safety);
    json.key("tick_errors").open('[');
    for (const auto& [bit, name] : kErrorNames) {
        if ((tally.tick_errors & bit) != 0) json.value(name);
    }
    json.close();
    json.field("state", name_of(report.state)).field("stopped_by", stopped_by(report));
    json.field("fault", name_of(report.fault));
    json.key("flight_recording");
    report.flight_recording.empty() ? json.raw("null") : json.value(report.flight_recording);
    return json.close().text();
}

}  // namespace hapticlod::station
