#include "station/kinematics.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace hapticlod::station {

Triple SerialPantograph::angles(const Triple& counts) const noexcept {
    Triple q{};
    for (std::size_t i = 0; i < 3; ++i) {
        q[i] = (counts[i] + home_counts[i]) * 2.0 * std::numbers::pi / counts_per_rev[i] * sign[i] * reduction[i];
    }
    return q;
}

Triple SerialPantograph::position_mm(const Triple& q) const noexcept {
    const auto& [la, lb, lc] = links_mm;
    const double reach = lb * std::sin(q[1]) + lc * std::sin(q[2]);
    return {std::cos(q[0]) * reach - origin_mm[0], std::sin(q[0]) * reach - origin_mm[1],
            la + lb * std::cos(q[1]) - lc * std::cos(q[2]) - origin_mm[2]};
}

std::array<double, 9> SerialPantograph::jacobian_mm(const Triple& q) const noexcept {
    const double lb = links_mm[1], lc = links_mm[2];
    const double sa = std::sin(q[0]), ca = std::cos(q[0]);
    const double sb = std::sin(q[1]), cb = std::cos(q[1]), sc = std::sin(q[2]), cc = std::cos(q[2]);
    const double reach = lb * sb + lc * sc;
    return {-sa * reach, lb * ca * cb, lc * ca * cc, ca * reach, lb * sa * cb, lc * sa * cc, 0.0, -lb * sb, lc * sc};
}

Triple SerialPantograph::currents_ma(const Triple& q, const Triple& force_n) const noexcept {
    const std::array<double, 9> j = jacobian_mm(q);
    Triple current{};
    double largest = 0.0;
    for (std::size_t i = 0; i < 3; ++i) {
        double torque_n_m = 0.0;
        for (std::size_t r = 0; r < 3; ++r) torque_n_m += 1e-3 * j[3 * r + i] * force_n[r];
        current[i] = 1e3 * torque_n_m * sign[i] * reduction[i] / torque_constant_n_m_a[i];
        largest = std::max(largest, std::abs(current[i]));
    }
    if (max_current_ma > 0.0 && largest > max_current_ma) {
        for (double& value : current) value *= max_current_ma / largest;
    }
    return current;
}

Triple Kinematics::to_world(const Triple& d) const noexcept {
    Triple w{};
    for (std::size_t r = 0; r < 3; ++r) w[r] = axes[3 * r] * d[0] + axes[3 * r + 1] * d[1] + axes[3 * r + 2] * d[2];
    return w;
}

Triple Kinematics::to_device(const Triple& w) const noexcept {
    Triple d{};
    for (std::size_t c = 0; c < 3; ++c) d[c] = axes[c] * w[0] + axes[3 + c] * w[1] + axes[6 + c] * w[2];
    return d;
}

}  // namespace hapticlod::station
