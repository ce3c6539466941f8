// A force-feedback device behind HID, as its profile describes it. Reads in the loop's thread (the queue is drained,
// the newest report kept), writes from a thread of its own.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "station/device.hpp"
#include "station/device_profile.hpp"
#include "station/force_writer.hpp"
#include "station/hid_connection.hpp"
#include "station/histogram.hpp"

namespace hapticlod::station {

class HidDevice final : public Device {
public:
    // `centre_mm`: the point of the scan, scan frame, that the device's origin stands for. The profile must outlive it.
    [[nodiscard]] static Result<std::unique_ptr<HidDevice>> open(const DeviceProfile& profile, const HidEntry& entry,
                                                                 const std::array<double, 3>& centre_mm);

    [[nodiscard]] DeviceTraits traits() const noexcept override;
    DeviceReading read(std::int64_t now_ns) noexcept override;
    void write(std::int64_t now_ns, const double force_n[3], bool enabled) noexcept override;

    // Waits, at most this long, until the last force has been handed to the device. Not from the loop.
    bool flush(double seconds) const noexcept { return !writer_ || writer_->flush(seconds); }
    [[nodiscard]] std::uint64_t written() const noexcept { return writer_ ? writer_->written() : 0; }
    // From posting a force to the report that says it was applied (echo_seq), where the device tells.
    [[nodiscard]] const Histogram& round_trip() const { return *round_trip_; }
    [[nodiscard]] const HidEntry& entry() const { return entry_; }

private:
    HidDevice(const DeviceProfile& profile, HidEntry entry, DeviceClaim claim, HidConnection reader,
              const std::array<double, 3>& centre_mm);
    void take(std::span<const std::uint8_t> report, LinkReport& seen, std::int64_t now_ns) noexcept;
    void follow_sequence(const ReportLayout& layout, std::span<const std::uint8_t> payload, LinkReport& seen,
                         std::int64_t now_ns) noexcept;
    void take_status(const ReportLayout& layout, std::span<const std::uint8_t> payload, LinkReport& seen) noexcept;
    bool take_position(const ReportLayout& layout, std::span<const std::uint8_t> payload) noexcept;
    void echo(const ReportLayout& layout, std::span<const std::uint8_t> payload, std::int64_t now_ns) noexcept;

    const DeviceProfile& profile_;
    HidEntry entry_;
    DeviceClaim claim_;
    HidConnection reader_;
    std::optional<ForceWriter> writer_;
    std::array<double, 3> centre_mm_;
    std::array<std::uint8_t, kMaxReportBytes + 1> in_{}, out_{};

    bool spoken_ = false;  // a report has come
    std::uint32_t last_seq_ = 0, last_t_us_ = 0;
    std::uint32_t repeats_ = 0;
    double time_s_ = 0.0;
    std::int64_t read_ns_ = 0;
    Triple device_mm_{};  // in the device's frame
    Triple angles_{};     // of joints
    Triple deflection_{};
    double orientation_[4] = {1.0, 0.0, 0.0, 0.0};
    std::uint32_t status_ = 0, buttons_ = 0;
    std::uint32_t sent_seq_ = 0;
    std::array<std::int64_t, 256> sent_ns_{};
    std::uint32_t echoed_seq_ = 0;
    std::unique_ptr<Histogram> round_trip_ = std::make_unique<Histogram>();
};

// Rotation matrix (row by row) to unit quaternion w x y z.
[[nodiscard]] std::array<double, 4> quaternion_of(const std::array<double, 9>& rotation);

}  // namespace hapticlod::station
