// A device and the hand that holds it, simulated: one mass, pulled by the hand's spring and damper toward where the
// hand wants to be, braked by the device's friction, pushed by the rendered force.
//
//     (m_hand + m_device) a = K_hand (target - x) + b_hand (target' - v) - b_device v - Coulomb(v) + F
//
// Hand: K = 500 N/m, b = 4.5 N s/m, m = 0.08 kg: placeholders of the field, not identified.
// Device: 0.05 kg, 5 N s/m, 0.05 N of friction per axis, 12 N, an omega.3-like arm; ASSUMED, not measured.
// A reading is the state of `read_delay_s` ago, rounded to the encoder's steps; a written force is felt `delay_s`
// later. The hand's orientation follows the path exactly.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>

#include "station/device.hpp"
#include "station/hand_path.hpp"

namespace hapticlod::station {

struct SimulatedBody {
    double hand_stiffness_n_mm = 0.5;
    double hand_damping_n_s_mm = 0.0045;
    double hand_mass_kg = 0.08;
    double device_mass_kg = 0.05;
    double device_damping_n_s_mm = 0.005;
    double device_friction_n = 0.05;  // Coulomb, on each axis
    double max_force_n = 12.0;
    double encoder_mm = 0.023;
    double delay_s = 1e-3;
    double read_delay_s = 0.0;
};

class SimulatedDevice final : public Device {
public:
    // The hand starts at rest at the beginning of the path.
    SimulatedDevice(HandPath path, const SimulatedBody& body);

    [[nodiscard]] DeviceTraits traits() const noexcept override;
    DeviceReading read(std::int64_t now_ns) noexcept override;  // the first call is time 0
    void write(std::int64_t now_ns, const double force_n[3], bool enabled) noexcept override;

    // The true state, before the encoder.
    [[nodiscard]] const double* position_mm() const { return position_mm_; }
    [[nodiscard]] const double* velocity_mm_s() const { return velocity_mm_s_; }

private:
    struct PendingForce {
        double from_s;
        double force_n[3];
    };
    void advance(double until_s) noexcept;
    void integrate(double until_s) noexcept;

    HandPath path_;
    SimulatedBody body_;
    std::int64_t start_ns_ = 0;
    bool started_ = false;
    double time_s_ = 0.0;
    double position_mm_[3];
    double velocity_mm_s_[3] = {0.0, 0.0, 0.0};
    double force_n_[3] = {0.0, 0.0, 0.0};
    std::array<PendingForce, 256> pending_{};  // written, not felt yet; a ring
    std::size_t first_ = 0, waiting_ = 0;
};

}  // namespace hapticlod::station
