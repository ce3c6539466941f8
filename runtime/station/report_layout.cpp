#include "station/report_layout.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "station/crc16.hpp"

namespace hapticlod::station {
namespace {

struct TypeFacts {
    const char* name;
    unsigned bytes;
    double least, most;
};
constexpr std::array<TypeFacts, 7> kTypes = {
    {{"i8", 1, -128.0, 127.0},
     {"u8", 1, 0.0, 255.0},
     {"i16", 2, -32768.0, 32767.0},
     {"u16", 2, 0.0, 65535.0},
     {"i32", 4, -2147483648.0, 2147483647.0},
     {"u32", 4, 0.0, 4294967295.0},
     {"f32", 4, -std::numeric_limits<float>::max(), std::numeric_limits<float>::max()}}};
constexpr std::array<const char*, kFieldNames> kNames = {
    "seq",    "t_us",     "pos_mm",  "vel_mm_s", "orientation", "encoders",    "deflection", "buttons",
    "status", "echo_seq", "force_n", "motor_ma", "flags",       "watchdog_ms", "crc16"};

const TypeFacts& facts(FieldType type) { return kTypes[static_cast<std::size_t>(type)]; }

std::uint32_t load(const std::uint8_t* at, unsigned bytes, bool big_endian) {
    std::uint32_t value = 0;
    for (unsigned i = 0; i < bytes; ++i) {
        const unsigned shift = 8 * (big_endian ? bytes - 1 - i : i);
        value |= static_cast<std::uint32_t>(at[i]) << shift;
    }
    return value;
}

void store(std::uint8_t* at, unsigned bytes, bool big_endian, std::uint32_t value) {
    for (unsigned i = 0; i < bytes; ++i) {
        const unsigned shift = 8 * (big_endian ? bytes - 1 - i : i);
        at[i] = static_cast<std::uint8_t>(value >> shift);
    }
}

double meant(FieldType type, std::uint32_t raw) {
    switch (type) {
        case FieldType::i8:
            return static_cast<std::int8_t>(raw);
        case FieldType::i16:
            return static_cast<std::int16_t>(raw);
        case FieldType::i32:
            return static_cast<std::int32_t>(raw);
        case FieldType::f32:
            return static_cast<double>(std::bit_cast<float>(raw));
        default:
            return raw;
    }
}

std::uint32_t raw_of(FieldType type, double value) {
    const TypeFacts& of = facts(type);
    value = std::clamp(value, of.least, of.most);
    if (type == FieldType::f32) return std::bit_cast<std::uint32_t>(static_cast<float>(value));
    return static_cast<std::uint32_t>(std::llround(value));
}

}  // namespace

unsigned size_of(FieldType type) { return facts(type).bytes; }
const char* name_of(FieldName name) { return kNames[static_cast<std::size_t>(name)]; }

std::optional<FieldType> field_type(std::string_view text) {
    for (std::size_t i = 0; i < kTypes.size(); ++i) {
        if (text == kTypes[i].name) return static_cast<FieldType>(i);
    }
    return std::nullopt;
}

std::optional<FieldName> field_name(std::string_view text) {
    for (std::size_t i = 0; i < kNames.size(); ++i) {
        if (text == kNames[i]) return static_cast<FieldName>(i);
    }
    return std::nullopt;
}

void ReportLayout::read(std::span<const std::uint8_t> payload, FieldName name, double* values) const noexcept {
    const Field& field = *(*this)[name];
    const unsigned size = size_of(field.type);
    for (unsigned i = 0; i < field.count; ++i) {
        const double raw = meant(field.type, load(payload.data() + field.offset + i * size, size, big_endian));
        values[i] = raw * field.scale + field.bias;
    }
}

std::uint32_t ReportLayout::read_bits(std::span<const std::uint8_t> payload, FieldName name) const noexcept {
    const Field& field = *(*this)[name];
    return load(payload.data() + field.offset, size_of(field.type), big_endian);
}

bool ReportLayout::write(std::span<std::uint8_t> payload, FieldName name, const double* values) const noexcept {
    const std::optional<Field>& field = (*this)[name];
    if (!field) return true;
    if (!std::all_of(values, values + field->count, [](double value) { return std::isfinite(value); })) return false;
    const unsigned size = size_of(field->type);
    for (unsigned i = 0; i < field->count; ++i) {
        const std::uint32_t raw = raw_of(field->type, (values[i] - field->bias) / field->scale);
        store(payload.data() + field->offset + i * size, size, big_endian, raw);
    }
    return true;
}

void ReportLayout::write_bits(std::span<std::uint8_t> payload, FieldName name, std::uint32_t value) const noexcept {
    const std::optional<Field>& field = (*this)[name];
    if (field) store(payload.data() + field->offset, size_of(field->type), big_endian, value);
}

void ReportLayout::seal(std::span<std::uint8_t> payload) const noexcept {
    const std::optional<Field>& field = (*this)[FieldName::crc16];
    if (field) store(payload.data() + field->offset, 2, big_endian, crc16_ccitt(payload.data(), field->offset));
}

bool ReportLayout::intact(std::span<const std::uint8_t> payload) const noexcept {
    const std::optional<Field>& field = (*this)[FieldName::crc16];
    return !field || load(payload.data() + field->offset, 2, big_endian) == crc16_ccitt(payload.data(), field->offset);
}

}  // namespace hapticlod::station
