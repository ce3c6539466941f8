#include "station/device_profile.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "station/stability.hpp"
#include "station/toml_reader.hpp"

namespace hapticlod::station {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kTiny = 1e-12;

constexpr FieldName kInputFields[] = {FieldName::seq,        FieldName::t_us,        FieldName::pos_mm,
                                      FieldName::vel_mm_s,   FieldName::orientation, FieldName::encoders,
                                      FieldName::deflection, FieldName::buttons,     FieldName::status,
                                      FieldName::echo_seq,   FieldName::crc16};
constexpr FieldName kOutputFields[] = {FieldName::seq,   FieldName::force_n,     FieldName::motor_ma,
                                       FieldName::flags, FieldName::watchdog_ms, FieldName::crc16};

// How many values a field has; 0: any.
unsigned needed_count(FieldName name) {
    switch (name) {
        case FieldName::pos_mm:
        case FieldName::vel_mm_s:
        case FieldName::encoders:
        case FieldName::deflection:
        case FieldName::force_n:
        case FieldName::motor_ma:
            return 3;
        case FieldName::orientation:
            return 4;
        default:
            return 1;
    }
}

// Fields that are counted or taken bit by bit.
bool needs_unsigned(FieldName name) { return needed_count(name) == 1; }

Field read_field(TomlReader reader, FieldName name, unsigned bytes, TomlReader& fields) {
    Field field;
    field.offset = static_cast<unsigned>(reader.integer("offset", 0, kMaxReportBytes - 1));
    const std::string type = reader.text("type");
    if (const auto known = field_type(type)) {
        field.type = *known;
    } else if (reader.has("type")) {
        reader.fault("type", "'" + type + "' is none of i8, u8, i16, u16, i32, u32, f32");
    }
    field.count = static_cast<unsigned>(reader.integer("count", 1, kMaxFieldCount, 1));
    field.scale = reader.number("scale", -1e9, 1e9, 1.0);
    if (std::abs(field.scale) < kTiny) reader.fault("scale", "must not be 0");
    field.bias = reader.number("bias", -1e9, 1e9, 0.0);
    reader.finish();
    const char* called = name_of(name);
    if (field.count != needed_count(name)) {
        fields.fault(
            called, "has count " + std::to_string(field.count) + ", should have " + std::to_string(needed_count(name)));
    }
    const bool whole = field.type == FieldType::u8 || field.type == FieldType::u16 || field.type == FieldType::u32;
    if (name == FieldName::crc16 ? field.type != FieldType::u16 : needs_unsigned(name) && !whole) {
        fields.fault(called, name == FieldName::crc16 ? "should have type u16" : "should have type u8, u16 or u32");
    }
    if (field.end() > bytes) {
        fields.fault(called,
                     "ends at byte " + std::to_string(field.end()) + " of a report of " + std::to_string(bytes));
    }
    return field;
}

// Of two fields that overlap, the one that begins later is to blame.
void check_overlaps(const ReportLayout& layout, TomlReader& fields) {
    for (std::size_t i = 0; i < kFieldNames; ++i) {
        for (std::size_t j = 0; j < kFieldNames; ++j) {
            const auto &earlier = layout.fields[i], &later = layout.fields[j];
            if (!earlier || !later || i == j) continue;
            if (later->offset < earlier->offset || (later->offset == earlier->offset && j < i)) continue;
            if (later->offset >= earlier->end()) continue;
            fields.fault(name_of(static_cast<FieldName>(j)),
                         std::string("overlaps ") + name_of(static_cast<FieldName>(i)));
            return;
        }
    }
}

ReportLayout read_layout(TomlReader reader, std::span<const FieldName> allowed) {
    ReportLayout layout;
    layout.report_id = static_cast<unsigned>(reader.integer("report_id", 0, 255));
    layout.bytes = static_cast<unsigned>(reader.integer("bytes", 1, kMaxReportBytes));
    const std::string endian = reader.text("endian", "little");
    if (endian != "little" && endian != "big") reader.fault("endian", "'" + endian + "' is none of little, big");
    layout.big_endian = endian == "big";
    TomlReader fields = reader.table("fields");
    for (const std::string& key : fields.keys()) {
        const auto name = field_name(key);
        if (!name || std::find(allowed.begin(), allowed.end(), *name) == allowed.end()) continue;  // finish() says it
        layout.fields[static_cast<std::size_t>(*name)] = read_field(fields.table(key), *name, layout.bytes, fields);
    }
    check_overlaps(layout, fields);
    fields.finish();
    return layout;
}

DeviceMatch read_match(TomlReader reader) {
    DeviceMatch match;
    match.vendor_id = static_cast<std::uint16_t>(reader.integer("vendor_id", 0, 0xFFFF));
    match.product_id = static_cast<std::uint16_t>(reader.integer("product_id", 0, 0xFFFF));
    if (reader.has("usage_page")) {
        match.usage_page = static_cast<std::uint16_t>(reader.integer("usage_page", 0, 0xFFFF));
    }
    if (reader.has("usage")) match.usage = static_cast<std::uint16_t>(reader.integer("usage", 0, 0xFFFF));
    match.product = reader.text("product", "");
    match.serial = reader.text("serial", "");
    reader.finish();
    return match;
}

StatusBits read_status_bits(TomlReader reader) {
    const auto mask = [&reader](const char* key) {
        const std::int64_t bit = reader.integer(key, 0, 31, -1);
        return bit < 0 ? 0u : 1u << bit;
    };
    const StatusBits bits{mask("motors"), mask("fault"), mask("estop"), mask("watchdog"), mask("calibrated")};
    reader.finish();
    return bits;
}

Triple triple(const std::vector<double>& values) { return {values[0], values[1], values[2]}; }

SerialPantograph read_pantograph(TomlReader& reader) {
    SerialPantograph form;
    form.links_mm = triple(reader.numbers("links_mm", 3, 1e-3, 1e4));
    form.origin_mm = triple(reader.numbers("origin_mm", 3, -1e4, 1e4, std::vector<double>(3, 0.0)));
    form.counts_per_rev = triple(reader.numbers("counts_per_rev", 3, 1.0, 1e9));
    form.reduction = triple(reader.numbers("reduction", 3, 1e-6, 1e6));
    form.sign = triple(reader.numbers("sign", 3, -1.0, 1.0));
    for (const double value : form.sign) {
        if (std::abs(value) != 1.0) {
            reader.fault("sign", "should hold 1 and -1 only");
            break;
        }
    }
    form.home_counts = triple(reader.numbers("home_counts", 3, -1e9, 1e9, std::vector<double>(3, 0.0)));
    form.torque_constant_n_m_a = triple(reader.numbers("torque_constant_n_m_a", 3, 1e-6, 1e3));
    form.max_current_ma = reader.number("max_current_ma", kTiny, 1e6);
    return form;
}

Kinematics read_kinematics(TomlReader reader) {
    Kinematics kinematics;
    const std::string kind = reader.text("kind");
    if (kind == "serial-rrr-pantograph") {
        kinematics.form = read_pantograph(reader);
    } else if (kind == "rate") {
        kinematics.form = RateControl{reader.number("gain_mm_s", kTiny, 1e6)};
    } else if (kind != "cartesian" && reader.has("kind")) {
        reader.fault("kind", "'" + kind + "' is none of cartesian, serial-rrr-pantograph, rate");
    }
    const std::vector<double> axes = reader.matrix("axes", 3, 3, std::vector<double>{1, 0, 0, 0, 1, 0, 0, 0, 1});
    std::copy(axes.begin(), axes.end(), kinematics.axes.begin());
    for (std::size_t r = 0; r < 3; ++r) {
        for (std::size_t c = 0; c < 3; ++c) {
            double product = 0.0;
            for (std::size_t k = 0; k < 3; ++k) product += axes[3 * r + k] * axes[3 * c + k];
            if (std::abs(product - (r == c ? 1.0 : 0.0)) > 1e-3) {
                reader.fault("axes", "its rows are not orthonormal");
                r = c = 3;
            }
        }
    }
    reader.finish();
    return kinematics;
}

DeviceLimits read_limits(TomlReader reader, bool motors) {
    const std::optional<double> absent = motors ? std::nullopt : std::optional(0.0);
    DeviceLimits limits;
    limits.max_force_n = reader.number("max_force_n", kTiny, 1000.0, absent);
    limits.max_force_rate_n_ms = reader.number("max_force_rate_n_ms", kTiny, 1000.0, absent);
    limits.max_speed_mm_s = reader.number("max_speed_mm_s", kTiny, 1e5);
    limits.resolution_mm = reader.number("resolution_mm", 0.0, 10.0, 0.0);
    limits.damping_n_s_mm = reader.number("damping_n_s_mm", 0.0, 10.0, 0.0);
    limits.max_stiffness_n_mm = reader.number("max_stiffness_n_mm", 0.0, 1000.0, 0.0);
    if (motors && limits.damping_n_s_mm == 0.0 && limits.max_stiffness_n_mm == 0.0) {
        reader.fault("damping_n_s_mm",
                     "missing: without it, or max_stiffness_n_mm, no stiffness is known to be stable");
    }
    reader.finish();
    return limits;
}

DeviceTiming read_timing(TomlReader reader, bool motors) {
    DeviceTiming timing;
    timing.rate_hz = reader.number("rate_hz", 10.0, 20'000.0);
    timing.delay_ms = reader.number("delay_ms", 0.0, 100.0, 0.0);
    timing.first_report_ms = reader.number("first_report_ms", 1.0, 10'000.0, 500.0);
    timing.watchdog_ms = reader.number("watchdog_ms", 0.0, 10'000.0, motors ? std::nullopt : std::optional(0.0));
    timing.host_first = reader.boolean("host_first", false);
    reader.finish();
    return timing;
}

SimulatedBody read_simulated(TomlReader reader) {
    SimulatedBody body;
    const auto take = [&reader](const char* key, double& value, double least, double most) {
        value = reader.number(key, least, most, value);
    };
    take("hand_stiffness_n_mm", body.hand_stiffness_n_mm, 0.0, 100.0);
    take("hand_damping_n_s_mm", body.hand_damping_n_s_mm, 0.0, 10.0);
    take("hand_mass_kg", body.hand_mass_kg, 0.0, 10.0);
    take("device_mass_kg", body.device_mass_kg, 1e-4, 10.0);
    take("device_damping_n_s_mm", body.device_damping_n_s_mm, 0.0, 10.0);
    take("device_friction_n", body.device_friction_n, 0.0, 10.0);
    take("max_force_n", body.max_force_n, 1e-3, 1000.0);
    take("encoder_mm", body.encoder_mm, 0.0, 10.0);
    take("delay_s", body.delay_s, 0.0, 0.1);
    take("read_delay_s", body.read_delay_s, 0.0, 0.1);
    reader.finish();
    return body;
}

// What the parts must have in common.
void check_whole(const DeviceProfile& profile, TomlReader& root) {
    const bool motors = profile.output.has_value();
    const auto given = [&profile](FieldName name) {
        return std::any_of(profile.inputs.begin(), profile.inputs.end(),
                           [name](const ReportLayout& layout) { return layout[name].has_value(); });
    };
    const auto needs = [&](FieldName in, FieldName out, const char* kind) {
        if (!given(in)) root.fault("input", std::string(kind) + " kinematics need a field " + name_of(in));
        if (motors && !(*profile.output)[out]) {
            root.fault("output", std::string(kind) + " kinematics need a field " + name_of(out));
        }
    };
    if (std::holds_alternative<Cartesian>(profile.kinematics.form)) {
        needs(FieldName::pos_mm, FieldName::force_n, "cartesian");
    } else if (std::holds_alternative<SerialPantograph>(profile.kinematics.form)) {
        needs(FieldName::encoders, FieldName::motor_ma, "serial-rrr-pantograph");
    } else {
        if (!given(FieldName::deflection)) root.fault("input", "rate kinematics need a field deflection");
        if (motors) root.fault("output", "rate kinematics are for devices without motors");
    }
    const std::array<double, 9>& m = profile.kinematics.axes;
    const double handed =
        m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) + m[2] * (m[3] * m[7] - m[4] * m[6]);
    if (handed < 0.0 && given(FieldName::orientation)) {
        root.fault("kinematics", "axes that mirror cannot turn an orientation");
    }
    if (root.has("status_bits") && !given(FieldName::status)) root.fault("status_bits", "no input has a field status");
    for (std::size_t i = 0; i < profile.inputs.size(); ++i) {
        for (std::size_t j = 0; j < i; ++j) {
            const unsigned id = profile.inputs[i].report_id;
            if (id == profile.inputs[j].report_id) {
                root.fault("input", "two input reports have id " + std::to_string(id));
            } else if (id == 0 || profile.inputs[j].report_id == 0) {
                root.fault("input", "a device with several reports numbers them from 1");
            }
        }
    }
}

Result<DeviceProfile> from_tree(const TomlNode& tree, const std::string& name) {
    std::vector<TomlFault> faults;
    TomlReader root(tree, "", faults);
    DeviceProfile profile;
    profile.file = name;
    (void)root.integer("schema", 1, 1);
    TomlReader device = root.table("device");
    profile.name = device.text("name");
    profile.status = device.text("status", "");
    if (root.has("simulated")) {
        profile.simulated = read_simulated(root.table("simulated"));
    } else {
        profile.match = read_match(device.table("match"));
        for (const TomlReader& input : root.tables("input")) profile.inputs.push_back(read_layout(input, kInputFields));
        if (!root.has("input")) root.fault("input", "missing");
        if (root.has("output")) profile.output = read_layout(root.table("output"), kOutputFields);
        const bool motors = profile.output.has_value();
        if (root.has("status_bits")) profile.status_bits = read_status_bits(root.table("status_bits"));
        profile.kinematics = read_kinematics(root.table("kinematics"));
        profile.limits = read_limits(root.table("limits"), motors);
        profile.timing = read_timing(root.table("timing"), motors);
        if (faults.empty()) check_whole(profile, root);
    }
    device.finish();
    root.finish();
    if (!faults.empty()) return joined(std::move(faults), name);
    return profile;
}

}  // namespace

double DeviceProfile::stability_limit_n_mm(double rendered_damping_n_s_mm, double period_s) const {
    if (!output) return kInfinity;
    double limit = limits.max_stiffness_n_mm > 0.0 ? limits.max_stiffness_n_mm : kInfinity;
    if (limits.damping_n_s_mm > 0.0) {
        limit = std::min(limit, station::stability_limit_n_mm(limits.damping_n_s_mm, rendered_damping_n_s_mm, period_s,
                                                              1e-3 * timing.delay_ms));
    }
    return limit;
}

Result<DeviceProfile> parse_device_profile(std::string_view toml, const std::string& name) {
    const auto tree = parse_toml(toml, name);
    if (!tree) return tree.fault();
    return from_tree(tree.value(), name);
}

Result<DeviceProfile> read_device_profile(const std::string& path) {
    const auto tree = read_toml(path);
    if (!tree) return tree.fault();
    return from_tree(tree.value(), path);
}

}  // namespace hapticlod::station
