// How a HID report is laid out: named fields at byte offsets. Reading and writing allocate nothing.
//
// Input fields   seq, t_us, pos_mm, vel_mm_s, orientation (w x y z), encoders, deflection, buttons, status, echo_seq
// Output fields  seq, force_n, motor_ma, flags, watchdog_ms
// Both           crc16: CRC-16/CCITT-FALSE of all bytes before it (crc16.hpp)
// A value is raw * scale + bias.
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace hapticlod::station {

enum class FieldType : std::uint8_t { i8, u8, i16, u16, i32, u32, f32 };
enum class FieldName : std::uint8_t {
    seq,
    t_us,
    pos_mm,
    vel_mm_s,
    orientation,
    encoders,
    deflection,
    buttons,
    status,
    echo_seq,
    force_n,
    motor_ma,
    flags,
    watchdog_ms,
    crc16
};
inline constexpr std::size_t kFieldNames = 15;
inline constexpr unsigned kMaxReportBytes = 1024;
inline constexpr unsigned kMaxFieldCount = 8;

[[nodiscard]] unsigned size_of(FieldType type);
[[nodiscard]] const char* name_of(FieldName name);
[[nodiscard]] std::optional<FieldType> field_type(std::string_view text);
[[nodiscard]] std::optional<FieldName> field_name(std::string_view text);

struct Field {
    FieldType type = FieldType::u8;
    unsigned offset = 0;
    unsigned count = 1;
    double scale = 1.0;
    double bias = 0.0;
    [[nodiscard]] unsigned end() const { return offset + count * size_of(type); }
};

struct ReportLayout {
    unsigned report_id = 0;  // 0: the device has no report ids
    unsigned bytes = 0;      // without the id
    bool big_endian = false;
    std::array<std::optional<Field>, kFieldNames> fields;

    [[nodiscard]] const std::optional<Field>& operator[](FieldName name) const {
        return fields[static_cast<std::size_t>(name)];
    }
    // `payload`: `bytes` long, without the id. The field must be there.
    void read(std::span<const std::uint8_t> payload, FieldName name, double* values) const noexcept;
    [[nodiscard]] std::uint32_t read_bits(std::span<const std::uint8_t> payload, FieldName name) const noexcept;
    // Integer fields are rounded and clamped to their range. False, and nothing is written, where a value is not
    // finite. Fields the layout lacks are skipped.
    bool write(std::span<std::uint8_t> payload, FieldName name, const double* values) const noexcept;
    void write_bits(std::span<std::uint8_t> payload, FieldName name, std::uint32_t value) const noexcept;
    // Puts the checksum in, where the layout has one; last.
    void seal(std::span<std::uint8_t> payload) const noexcept;
    [[nodiscard]] bool intact(std::span<const std::uint8_t> payload) const noexcept;
};

}  // namespace hapticlod::station
