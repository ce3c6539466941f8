// How stiff a wall a device can render without shaking.
#pragma once

namespace hapticlod::station {

// Largest stable stiffness, N/mm: K < (b + B) / (T/2 + t_d), Colgate and Schenkel with the delay of Gil and Hulin
// (PERCEPTION.md section 5). b: the device's own damping, B: rendered damping, N s/mm; T: period, t_d: delay, s.
// The hand's damping is left out: a hand may let go.
[[nodiscard]] constexpr double stability_limit_n_mm(double device_damping_n_s_mm, double rendered_damping_n_s_mm,
                                                    double period_s, double delay_s) {
    return (device_damping_n_s_mm + rendered_damping_n_s_mm) / (0.5 * period_s + delay_s);
}

// What is rendered at most: half the limit.
inline constexpr double kStiffnessShare = 0.5;

}  // namespace hapticlod::station
