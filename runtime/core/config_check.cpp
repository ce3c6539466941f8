#include "core/config_check.hpp"

#include <cmath>

namespace hapticlod {
namespace {

std::string number_fault(const char* name, double value, double least, double most) {
    // The tick takes subnormal numbers for 0, and a limit of 0 is none.
    if (std::fpclassify(value) == FP_SUBNORMAL) return std::string(name) + " is so small that it counts as 0: say 0";
    if (std::isfinite(value) && value >= least && value <= most) return {};
    return std::string(name) + " = " + std::to_string(value) + " is outside [" + std::to_string(least) + ", " +
           std::to_string(most) + "]";
}

}  // namespace

std::string check_config(const ConfigData& c) {
    if (c.version != kConfigVersion) return "config version " + std::to_string(c.version) + " is not known";
    if (c.level_count < 1 || c.level_count > kMaxLevels)
        return "level_count = " + std::to_string(c.level_count) + " is outside [1, 8]";
    if (c.mapping > 1) return "mapping is neither paper nor two_sided";
    if (c.policy > 1) return "policy is neither velocity nor distance";
    if (c.shading > 1) return "shading is neither 0 nor 1";
    const struct {
        const char* name;
        double value, least, most;
    } fields[] = {{"origin_mm.x", c.origin_mm[0], -1e9, 1e9},
                  {"origin_mm.y", c.origin_mm[1], -1e9, 1e9},
                  {"origin_mm.z", c.origin_mm[2], -1e9, 1e9},
                  {"loop_hz", c.loop_hz, 1.0, 1e5},
                  {"budget_us", c.budget_us, 0.0, 1e9},
                  {"stiffness_n_mm", c.stiffness_n_mm, 0.0, 1e6},
                  {"damping_n_s_mm", c.damping_n_s_mm, 0.0, 1e3},
                  {"friction_static", c.friction_static, 0.0, 10.0},
                  {"friction_dynamic", c.friction_dynamic, 0.0, 10.0},
                  {"filter_hz", c.filter_hz, 0.0, 1e5},
                  {"hysteresis", c.hysteresis, 0.0, 0.99},
                  {"dwell_s", c.dwell_s, 0.0, 1e3},
                  {"l_in_mm", c.l_in_mm, 0.0, 1e6},
                  {"l_out_mm", c.l_out_mm, 0.0, 1e6},
                  {"closest_bound_mm", c.closest_bound_mm, 0.0, 1e6},
                  {"blend_s", c.blend_s, 0.0, 10.0},
                  {"max_force_n", c.max_force_n, 0.0, 1e6},
                  {"max_slew_n_s", c.max_slew_n_s, 0.0, 1e9},
                  {"engage_s", c.engage_s, 0.0, 60.0},
                  {"crack_mm", c.crack_mm, 0.0, 1e3},
                  {"work_limit", c.work_limit, 0.0, 1e12}};
    for (const auto& f : fields)
        if (std::string fault = number_fault(f.name, f.value, f.least, f.most); !fault.empty()) return fault;
    for (std::uint32_t i = 0; i < c.level_count; ++i) {
        if (i + 1 < c.level_count) {
            if (std::string fault = number_fault("speeds_mm_s", c.speeds_mm_s[i], 0.0, 1e9); !fault.empty())
                return fault;
            if (i > 0 && c.speeds_mm_s[i] < c.speeds_mm_s[i - 1]) return "speeds_mm_s must not decrease";
        }
        if (c.balls[i] < 1 || c.balls[i] > kMaxBalls) return "balls of a level is outside [1, 4096]";
    }
    return {};
}

}  // namespace hapticlod
