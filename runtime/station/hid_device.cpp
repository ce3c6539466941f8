#include "station/hid_device.hpp"

#include <algorithm>
#include <cmath>

namespace hapticlod::station {
namespace {

constexpr std::uint32_t kMostDrained = 256;  // four queues of hidraw: a device that never stops must not stop the loop

std::uint32_t mask_of(const Field& field) {
    const unsigned bits = 8 * size_of(field.type);
    return bits == 32 ? 0xFFFFFFFFu : (1u << bits) - 1u;
}

std::array<double, 4> product(const std::array<double, 4>& a, const double b[4]) {
    return {
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]};
}

}  // namespace

std::array<double, 4> quaternion_of(const std::array<double, 9>& m) {
    // The largest of the four is found first: its square root loses nothing.
    const double t[4] = {m[0] + m[4] + m[8], m[0] - m[4] - m[8], m[4] - m[0] - m[8], m[8] - m[0] - m[4]};
    const auto most = static_cast<std::size_t>(std::max_element(t, t + 4) - t);
    const double r = std::sqrt(1.0 + t[most]), f = 0.5 / r;
    switch (most) {
        case 0:
            return {0.5 * r, (m[7] - m[5]) * f, (m[2] - m[6]) * f, (m[3] - m[1]) * f};
        case 1:
            return {(m[7] - m[5]) * f, 0.5 * r, (m[1] + m[3]) * f, (m[2] + m[6]) * f};
        case 2:
            return {(m[2] - m[6]) * f, (m[1] + m[3]) * f, 0.5 * r, (m[5] + m[7]) * f};
        default:
            return {(m[3] - m[1]) * f, (m[2] + m[6]) * f, (m[5] + m[7]) * f, 0.5 * r};
    }
}

Result<std::unique_ptr<HidDevice>> HidDevice::open(const DeviceProfile& profile, const HidEntry& entry,
                                                   const std::array<double, 3>& centre_mm) {
    auto claim = DeviceClaim::take(entry.path);
    if (!claim) return claim.fault();
    auto reader = HidConnection::open(entry.path);
    if (!reader) return reader.fault();
    std::unique_ptr<HidDevice> device(
        new HidDevice(profile, entry, std::move(claim).value(), std::move(reader).value(), centre_mm));
    if (profile.output) {
        auto writer = HidConnection::open(entry.path);
        if (!writer) return writer.fault();
        device->writer_.emplace(std::move(writer).value());
    }
    return device;
}

HidDevice::HidDevice(const DeviceProfile& profile, HidEntry entry, DeviceClaim claim, HidConnection reader,
                     const std::array<double, 3>& centre_mm)
    : profile_(profile),
      entry_(std::move(entry)),
      claim_(std::move(claim)),
      reader_(std::move(reader)),
      centre_mm_(centre_mm) {}

DeviceTraits HidDevice::traits() const noexcept {
    const DeviceLimits& limits = profile_.limits;
    return {profile_.name,
            limits.max_force_n,
            limits.max_speed_mm_s,
            limits.resolution_mm,
            limits.damping_n_s_mm,
            1e-3 * profile_.timing.delay_ms,
            1e3 * limits.max_force_rate_n_ms,
            1e-3 * profile_.timing.first_report_ms};
}

DeviceReading HidDevice::read(std::int64_t now_ns) noexcept {
    LinkReport seen;
    seen.fresh = false;
    seen.drained = 0;
    while (seen.drained < kMostDrained) {
        const int bytes = reader_.read(in_);
        if (bytes == 0) break;
        if (bytes < 0) {
            seen.gone = true;
            break;
        }
        ++seen.drained;
        take({in_.data(), static_cast<std::size_t>(bytes)}, seen, now_ns);
    }
    if (const auto* rate = std::get_if<RateControl>(&profile_.kinematics.form)) {
        // It speaks only when it is moved: what it said last goes on.
        const double dt_s = spoken_ ? static_cast<double>(now_ns - read_ns_) * 1e-9 : 0.0;
        for (std::size_t i = 0; i < 3; ++i) device_mm_[i] += rate->gain_mm_s * deflection_[i] * dt_s;
        time_s_ = static_cast<double>(now_ns) * 1e-9;
        seen.fresh = !seen.gone;
        spoken_ = true;
    }
    read_ns_ = now_ns;
    seen.repeats = repeats_;
    seen.status = status_;
    seen.buttons = buttons_;
    if (writer_) {
        seen.gone = seen.gone || writer_->failed();
        seen.writing_s = writer_->writing_s(now_ns);
    }
    DeviceReading reading{{}, time_s_, seen};
    const Triple world = profile_.kinematics.to_world(device_mm_);
    for (std::size_t i = 0; i < 3; ++i) reading.pose.position_mm[i] = centre_mm_[i] + world[i];
    std::copy_n(orientation_, 4, reading.pose.orientation);
    return reading;
}

void HidDevice::take(std::span<const std::uint8_t> report, LinkReport& seen, std::int64_t now_ns) noexcept {
    const ReportLayout* layout = nullptr;
    for (const ReportLayout& known : profile_.inputs) {
        if (known.report_id == 0 || (!report.empty() && report[0] == known.report_id)) layout = &known;
    }
    const std::span<const std::uint8_t> payload =
        layout != nullptr && layout->report_id != 0 ? report.subspan(1) : report;
    if (layout == nullptr || payload.size() != layout->bytes || !layout->intact(payload)) {
        seen.wrong_report = true;
        return;
    }
    follow_sequence(*layout, payload, seen, now_ns);
    take_status(*layout, payload, seen);
    echo(*layout, payload, now_ns);
    if (take_position(*layout, payload)) seen.fresh = true;
    spoken_ = true;
}

void HidDevice::follow_sequence(const ReportLayout& layout, std::span<const std::uint8_t> payload, LinkReport& seen,
                                std::int64_t now_ns) noexcept {
    const bool has_seq = layout[FieldName::seq].has_value(), has_time = layout[FieldName::t_us].has_value();
    const std::uint32_t seq = has_seq ? layout.read_bits(payload, FieldName::seq) : 0;
    const std::uint32_t t_us = has_time ? layout.read_bits(payload, FieldName::t_us) : 0;
    std::uint32_t steps = 1;
    if (has_seq && spoken_) {
        const std::uint32_t mask = mask_of(*layout[FieldName::seq]);
        steps = (seq - last_seq_) & mask;
        // More than half a turn ahead is behind: it started again. What was lost then nobody can count.
        if (steps > mask / 2) steps = 1;
        seen.lost += steps > 1 ? steps - 1 : 0;
    }
    // A still hand is no fault: only a device that numbers or stamps its reports can be called frozen.
    const bool same = spoken_ && (has_seq ? steps == 0 : has_time && t_us == last_t_us_);
    repeats_ = same ? repeats_ + 1 : 0;
    if (has_time) {
        const std::uint32_t ticks = spoken_ ? (t_us - last_t_us_) & mask_of(*layout[FieldName::t_us]) : 0;
        time_s_ += 1e-6 * layout[FieldName::t_us]->scale * ticks;
    } else if (has_seq) {
        time_s_ += steps / profile_.timing.rate_hz;
    } else {
        time_s_ = static_cast<double>(now_ns) * 1e-9;
    }
    last_seq_ = seq;
    last_t_us_ = t_us;
}

void HidDevice::take_status(const ReportLayout& layout, std::span<const std::uint8_t> payload,
                            LinkReport& seen) noexcept {
    if (layout[FieldName::buttons]) buttons_ = layout.read_bits(payload, FieldName::buttons);
    if (!layout[FieldName::status]) return;
    status_ = layout.read_bits(payload, FieldName::status);
    const StatusBits& bits = profile_.status_bits;
    seen.device_fault = seen.device_fault || (status_ & bits.fault) != 0;  // also where a later report takes it back
    seen.estop = seen.estop || (status_ & bits.estop) != 0;
    seen.watchdog_tripped = (status_ & bits.watchdog) != 0;
    seen.calibrated = bits.calibrated == 0 || (status_ & bits.calibrated) != 0;
}

bool HidDevice::take_position(const ReportLayout& layout, std::span<const std::uint8_t> payload) noexcept {
    if (layout[FieldName::orientation]) layout.read(payload, FieldName::orientation, orientation_);
    if (layout[FieldName::deflection]) layout.read(payload, FieldName::deflection, deflection_.data());
    if (layout[FieldName::orientation]) {
        const std::array<double, 4> turned = product(quaternion_of(profile_.kinematics.axes), orientation_);
        std::copy(turned.begin(), turned.end(), orientation_);
    }
    if (const auto* pantograph = std::get_if<SerialPantograph>(&profile_.kinematics.form)) {
        if (!layout[FieldName::encoders]) return false;
        Triple counts{};
        layout.read(payload, FieldName::encoders, counts.data());
        angles_ = pantograph->angles(counts);
        device_mm_ = pantograph->position_mm(angles_);
        return true;
    }
    if (!layout[FieldName::pos_mm]) return false;
    layout.read(payload, FieldName::pos_mm, device_mm_.data());
    return true;
}

void HidDevice::echo(const ReportLayout& layout, std::span<const std::uint8_t> payload, std::int64_t now_ns) noexcept {
    if (!layout[FieldName::echo_seq] || !profile_.output) return;
    const std::uint32_t seq = layout.read_bits(payload, FieldName::echo_seq);
    if (seq == echoed_seq_ || sent_seq_ - seq >= sent_ns_.size()) return;
    echoed_seq_ = seq;
    round_trip_->record(now_ns - sent_ns_[seq % sent_ns_.size()]);
}

void HidDevice::write(std::int64_t now_ns, const double force_n[3], bool enabled) noexcept {
    if (!writer_) return;
    const ReportLayout& layout = *profile_.output;
    const std::span<std::uint8_t> payload(out_.data() + 1, layout.bytes);
    std::fill(payload.begin(), payload.end(), std::uint8_t{0});
    out_[0] = static_cast<std::uint8_t>(layout.report_id);
    const Triple force = profile_.kinematics.to_device({force_n[0], force_n[1], force_n[2]});
    const auto* pantograph = std::get_if<SerialPantograph>(&profile_.kinematics.form);
    const Triple motors = pantograph != nullptr ? pantograph->currents_ma(angles_, force) : force;
    // What is not finite leaves its field at 0.
    (void)layout.write(payload, pantograph != nullptr ? FieldName::motor_ma : FieldName::force_n, motors.data());
    layout.write_bits(payload, FieldName::seq, ++sent_seq_);
    layout.write_bits(payload, FieldName::flags, enabled ? 1u : 0u);
    layout.write_bits(payload, FieldName::watchdog_ms,
                      static_cast<std::uint32_t>(std::lround(profile_.timing.watchdog_ms)));
    layout.seal(payload);
    sent_ns_[sent_seq_ % sent_ns_.size()] = now_ns;
    writer_->post({out_.data(), layout.bytes + 1u}, now_ns);
}

}  // namespace hapticlod::station
