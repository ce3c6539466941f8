// What must hold in every tick of the soak test. The records are judged from outside: poses in, numbers out.
#pragma once
#include <cstdio>
#include <cstring>

#include "tests/soak_motion.hpp"

namespace hapticlod::test {

inline constexpr double kSoakSlackMm = 1e-3;  // 1 um

struct SoakTally {
    std::uint64_t ticks = 0, contacts = 0, switches = 0, mapped = 0, lost = 0, started_inside = 0, faults = 0, held = 0,
                  not_converged = 0, distances = 0, sides = 0, paths = 0;
    double deepest_mm = std::numeric_limits<double>::max();  // least clearance seen
    double largest_step_n = 0.0;

    void add(const SoakTally& o) {
        std::uint64_t SoakTally::*const sums[] = {
            &SoakTally::ticks,          &SoakTally::contacts,  &SoakTally::switches, &SoakTally::mapped,
            &SoakTally::lost,           &SoakTally::faults,    &SoakTally::held,     &SoakTally::not_converged,
            &SoakTally::started_inside, &SoakTally::distances, &SoakTally::sides,    &SoakTally::paths};
        for (const auto member : sums) this->*member += o.*member;
        deepest_mm = std::min(deepest_mm, o.deepest_mm);
        largest_step_n = std::max(largest_step_n, o.largest_step_n);
    }
};

class SoakCheck {
public:
    // Every `thinning`-th tick is held against all triangles.
    SoakCheck(const SoakCase& c, std::uint64_t thinning) : case_(c), thinning_(thinning) {}

    // Empty: nothing to object to.
    std::string judge(const SoakStep& step, const TickRecord& row) {
        const std::string fault = look(step, row);
        last_ = row;
        ++tally_.ticks;
        return fault;
    }
    [[nodiscard]] const SoakTally& tally() const { return tally_; }

private:
    std::string look(const SoakStep& step, const TickRecord& row) {
        for (const double* v : {row.hip_mm, row.scp_mm, row.force_n, row.torque_n_mm})
            for (int k = 0; k < 3; ++k)
                if (!std::isfinite(v[k])) return "a number of the record is not finite";
        if (!std::isfinite(row.speed_mm_s)) return "the speed is not finite";
        const bool first = tally_.ticks == 0;
        const double dt = first ? 1e-3 : period(step.time_s, row.errors);
        if (first) clock_s_ = std::isfinite(step.time_s) ? step.time_s : 0.0, last_stamp_s_ = step.time_s;
        const bool anew = first || (row.errors & kErrHipJump) != 0;
        count(row, anew);
        if (std::string fault = judge_force(row, dt, anew); !fault.empty()) return fault;
        follow_turn(step, row);
        return judge_place(row, dt, anew);
    }

    // How long the runtime must take the period for: one wrong stamp is passed over, as long as the nominal period; a
    // clock that was set back goes on from where it is.
    double period(double now_s, std::uint32_t errors) {
        constexpr double kNominal = 1e-3;
        double dt = now_s - clock_s_;
        if (dt > 0.0 && std::isfinite(dt)) {
            clock_s_ = now_s;
        } else {
            const double since = now_s - last_stamp_s_;
            const bool set_back = since > 0.0 && since < 10.0 * kNominal;
            dt = set_back ? since : kNominal;
            clock_s_ = set_back ? now_s : clock_s_ + kNominal;
            said_period_ = set_back || (errors & kErrPeriod) != 0;
        }
        last_stamp_s_ = now_s;
        return dt;
    }

    void count(const TickRecord& row, bool anew) {
        tally_.contacts += row.contact;
        tally_.switches += !anew && row.level != last_.level;
        tally_.mapped += row.mapping != 0;
        tally_.lost += (row.errors & kErrContactLost) != 0;
        tally_.started_inside += (row.errors & kErrStartInside) != 0;
        tally_.faults += (row.errors & (kErrHipNotFinite | kErrPeriod | kErrHipJump)) != 0;
        tally_.held += (row.errors & kErrTurnHeld) != 0;
        tally_.not_converged += (row.errors & kErrNotConverged) != 0;
    }

    std::string judge_force(const TickRecord& row, double dt, bool anew) {
        if (!said_period_) return "a period that is none is not in the errors";
        const Point force = {row.force_n[0], row.force_n[1], row.force_n[2]};
        if (length(force) > case_.config.max_force_n * (1.0 + 1e-9)) return "force above the limit";
        // A jump begins anew, from no force.
        const Point before = anew ? Point{} : Point{last_.force_n[0], last_.force_n[1], last_.force_n[2]};
        const double change = length(force - before);
        tally_.largest_step_n = std::max(tally_.largest_step_n, change);
        if (change > case_.config.max_slew_n_s * dt * (1.0 + 1e-9) + 1e-12) return "force step above the slew limit";
        return {};
    }

    // The orientation that the tool has: the last valid one. On its way there (TURN_HELD) it is not known.
    void follow_turn(const SoakStep& step, const TickRecord& row) {
        facing_known_ = (row.errors & kErrTurnHeld) == 0 && (facing_known_ || (row.errors & kErrHipNotFinite) == 0);
        if ((row.errors & (kErrHipNotFinite | kErrTurnHeld)) == 0)
            std::copy(step.pose.orientation, step.pose.orientation + 4, q_);
    }

    std::string judge_place(const TickRecord& row, double dt, bool anew) {
        // While a switch's offset decays the rendered place is meant to be off the surface.
        if (!anew && row.level != last_.level) blend_left_s_ = case_.config.blend_s + dt;
        const bool blended = blend_left_s_ > 0.0 && !anew;
        blend_left_s_ -= dt;
        const Point origin = {case_.config.origin_mm[0], case_.config.origin_mm[1], case_.config.origin_mm[2]};
        const Point scp = Point{row.scp_mm[0], row.scp_mm[1], row.scp_mm[2]} - origin;
        const Point hip = Point{row.hip_mm[0], row.hip_mm[1], row.hip_mm[2]} - origin;
        const Point pull = scp - hip;
        const double depth = length(pull);
        // The same place, a little off the surface: on it, a point has no side.
        Place now{!blended && !(row.contact != 0 && depth < 1e-6), row.level, scp, hip, {}};
        now.off = case_.tool[0].radius_mm > 0.0 || row.contact == 0 ? scp : scp + pull * (5.0 * kSoakSlackMm / depth);
        const Place before = anew ? Place{} : place_;
        place_ = now;
        if (!now.known || (case_.tool.size() > 1 && !facing_known_)) return {};
        const bool sampled = tally_.ticks % thinning_ == 0;
        const std::size_t used = std::min<std::size_t>(case_.config.balls[row.level], case_.tool.size());
        for (std::size_t i = 0; i < used; ++i) {
            const BallData& b = case_.tool[i];
            const Point at = scp + turned(q_, {b.centre_mm[0], b.centre_mm[1], b.centre_mm[2]});
            if (std::string fault = judge_ball(at, b.radius_mm, row.level, sampled); !fault.empty())
                return fault + " (ball " + std::to_string(i) + ")";
        }
        if (case_.tool.size() == 1 && before.known && before.level == now.level)
            return judge_path(before, now, sampled);
        return {};
    }

    std::string judge_ball(const Point& at, double radius_mm, std::size_t level, bool sampled) {
        const SoakBody& body = *case_.body;
        char text[160];
        if (body.plate) {
            // Exact outside and inside: all levels of the plate are one box.
            const Point over = {std::abs(at[0]) - kPlateHalfMm, std::abs(at[1]) - kPlateHalfMm,
                                std::abs(at[2]) - 0.5 * kPlateThicknessMm};
            const double inside = std::min(std::max({over[0], over[1], over[2]}), 0.0);
            const double outside = length({std::max(over[0], 0.0), std::max(over[1], 0.0), std::max(over[2], 0.0)});
            return judge_clearance(inside + outside - radius_mm);
        }
        if (const double out = length(at) - body.innermost_mm[level]; out < radius_mm - kSoakSlackMm) {
            // Nearer to the middle than any of the surface, less a ball's radius: no sampling needed.
            if (out < -kSoakSlackMm || distance_to(at, body.corners[level]) < radius_mm - kSoakSlackMm) {
                std::snprintf(text, sizeof text, "%.6g mm inside the innermost sphere", -out);
                return text;
            }
        }
        if (!sampled) return {};
        ++tally_.sides;
        double clearance = distance_to(at, body.corners[level]);
        if (winding_number(at, body.corners[level]) > 0.5) clearance = -clearance;
        return judge_clearance(clearance - radius_mm);
    }

    std::string judge_clearance(double clearance_mm) {
        ++tally_.distances;
        tally_.deepest_mm = std::min(tally_.deepest_mm, clearance_mm);
        if (clearance_mm >= -kSoakSlackMm) return {};
        char text[80];
        std::snprintf(text, sizeof text, "the SCP penetrates by %.6g um", -1e3 * clearance_mm);
        return text;
    }

    struct Place {
        bool known = false;
        std::size_t level = 0;
        Point scp{}, hip{}, off{};
    };

    // From tick to tick on one level: a closed surface is crossed an even number of times (a chord over a bump goes in
    // and out), and not at all by a step shorter than the ball is wide. A plate is thinner than a step: there it is the
    // side that must not change, but round the border.
    std::string judge_path(const Place& before, const Place& now, bool sampled) {
        const double step = length(now.scp - before.scp), r = case_.tool[0].radius_mm;
        if (case_.body->plate) {
            const auto margin = [](const Point& p) { return kPlateHalfMm - std::max(std::abs(p[0]), std::abs(p[1])); };
            const double way = length(now.hip - before.hip);
            if (std::min(margin(before.scp), margin(now.scp)) > 2.0 * way + 2.0 * r) {
                ++tally_.paths;
                if ((before.scp[2] > 0.0) != (now.scp[2] > 0.0)) return "through the plate";
            }
            return {};
        }
        if (!sampled) return {};
        ++tally_.paths;
        const int crossed = crossings(before.off, now.off, case_.body->corners[now.level]);
        if (crossed % 2 != 0) return "the SCP's path leads through the surface";
        if (step < 2.0 * (r - kSoakSlackMm) && crossed != 0) return "the SCP's path cuts the surface";
        return {};
    }

    const SoakCase& case_;
    std::uint64_t thinning_;
    SoakTally tally_;
    TickRecord last_{};
    bool facing_known_ = true;
    Place place_;
    double clock_s_ = 0.0, last_stamp_s_ = 0.0, blend_left_s_ = 0.0;
    double q_[4] = {1.0, 0.0, 0.0, 0.0};
    bool said_period_ = true;
};

}  // namespace hapticlod::test
