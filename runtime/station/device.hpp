// What the loop needs of a force-feedback device: the newest pose in, a force out.
#pragma once
#include <string_view>

#include "core/renderer.hpp"

namespace hapticlod::station {

struct DeviceReading {
    Pose pose;      // scan frame
    double time_s;  // the device's clock
};

struct DeviceTraits {
    std::string_view name;
    double max_force_n;
    double max_speed_mm_s;  // faster than any hand moves it: a reading beyond is a fault
    double encoder_mm;      // position resolution
    double damping_n_s_mm;  // its own, physical
    double delay_s;         // from a written force to its being felt
};

class Device {
public:
    virtual ~Device() = default;
    [[nodiscard]] virtual DeviceTraits traits() const noexcept = 0;
    // `now_ns` is the loop's clock. Called from the loop: no allocation, no waiting.
    virtual DeviceReading read(std::int64_t now_ns) noexcept = 0;
    virtual void write(std::int64_t now_ns, const double force_n[3]) noexcept = 0;
};

}  // namespace hapticlod::station
