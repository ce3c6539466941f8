// From what a device reports to a position, and from a force to what its motors get. Closed forms with names.
#pragma once
#include <array>
#include <variant>

namespace hapticlod::station {

using Triple = std::array<double, 3>;

// Firmware that reports millimetres and takes newtons.
struct Cartesian {};

// Three joints with encoders and motors, the WoodenHaptics family: a turning body, and two links of a pantograph.
//     x = cos a (Lb sin b + Lc sin c),  y = sin a (...),  z = La + Lb cos b - Lc cos c
// Joint angle = (counts + home) 2 pi / counts_per_rev * sign * reduction. Torque by Jacobian transpose.
struct SerialPantograph {
    Triple links_mm{}, origin_mm{};
    Triple counts_per_rev{}, reduction{}, sign{}, home_counts{};
    Triple torque_constant_n_m_a{};
    double max_current_ma = 0.0;

    [[nodiscard]] Triple angles(const Triple& counts) const noexcept;
    [[nodiscard]] Triple position_mm(const Triple& angles) const noexcept;
    // d position / d angle, mm, row by row.
    [[nodiscard]] std::array<double, 9> jacobian_mm(const Triple& angles) const noexcept;
    // Motor currents for a force in the device's frame; scaled together where one exceeds its limit.
    [[nodiscard]] Triple currents_ma(const Triple& angles, const Triple& force_n) const noexcept;
};

// Deflection is velocity: a position-less input device.
struct RateControl {
    double gain_mm_s = 0.0;
};

struct Kinematics {
    std::variant<Cartesian, SerialPantograph, RateControl> form;
    std::array<double, 9> axes{1, 0, 0, 0, 1, 0, 0, 0, 1};  // device -> world, orthonormal, row by row

    [[nodiscard]] Triple to_world(const Triple& device) const noexcept;
    [[nodiscard]] Triple to_device(const Triple& world) const noexcept;
};

}  // namespace hapticlod::station
