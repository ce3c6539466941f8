// Device profiles, report layouts and kinematics, without a device.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>

#include "station/crc16.hpp"
#include "station/device_profile.hpp"
#include "station/hid_device.hpp"
#include "station/toml_file.hpp"

#ifndef HAPTICLOD_REPOSITORY
#error "the build says where the shipped profiles are"
#endif

namespace hapticlod::station {
namespace {

constexpr const char* kShipped = HAPTICLOD_REPOSITORY "/configs/devices/";

TEST(Profile, ShippedOnesAreRead) {
    int count = 0;
    for (const auto& file : std::filesystem::directory_iterator(kShipped)) {
        if (file.path().extension() != ".toml") continue;  // rules and limits lie beside them
        const auto profile = read_device_profile(file.path());
        EXPECT_TRUE(profile) << profile.fault().line();
        ++count;
    }
    EXPECT_GE(count, 5);
}

TEST(Profile, SimulatorFileIsTheBuiltInSimulator) {
    const auto profile = read_device_profile(std::string(kShipped) + "simulator.toml");
    ASSERT_TRUE(profile && profile.value().simulated);
    const SimulatedBody &file = *profile.value().simulated, built_in{};
    EXPECT_EQ(std::memcmp(&file, &built_in, sizeof(SimulatedBody)), 0);
}

TEST(Profile, SyntaxErrorHasItsPlace) {
    const auto parsed = parse_device_profile("schema = 1\n[device\n", "x.toml");
    ASSERT_FALSE(parsed);
    EXPECT_EQ(parsed.fault().where.substr(0, 9), "x.toml:2:");
}

// toml++ 3.3 has undefined behaviour on these; sanitizers show it where the letters are not raised first.
TEST(Toml, LettersBeyondAsciiAreRefusedWhereTheyDoNotBelong) {
    for (const char* text : {"name =\u00e91", "\u00e9 = 1", "a = 1 \u00e9", "a = [1, \u00e9]", "a.\u00e9 = 1",
                             "[\u00e9]", "a = \u3001", "a = 1\u2028", "a = 1\u00a0", "a = \ufeff1", "a =\U0001f600"}) {
        const auto parsed = parse_toml(text, "x.toml");
        ASSERT_FALSE(parsed) << text;
        EXPECT_TRUE(parsed.fault().where.starts_with("x.toml:1:")) << parsed.fault().line();
        EXPECT_TRUE(parsed.fault().what.starts_with("not TOML: ")) << parsed.fault().line();
    }
    // toml++ calls it what it is, not what it was raised to.
    EXPECT_NE(parse_toml("a = 1 \u00e9", "x.toml").fault().what.find("\u00e9"), std::string::npos);
}

TEST(Toml, LettersBeyondAsciiAreKeptWhereTheyBelong) {
    const auto parsed = parse_toml(
        "\xef\xbb\xbf# \u00e9\u2028\n'\u00fcber' = \"\u00e9\\u00e9\u3000\ufeff\U0001f600\"\nb = "
        "\"\"\"\\\n\u00a0c\"\"\" # \u2028\n",
        "x.toml");
    ASSERT_TRUE(parsed) << parsed.fault().line();
    ASSERT_NE(parsed.value().find("\u00fcber"), nullptr);
    EXPECT_EQ(parsed.value().find("\u00fcber")->text, "\u00e9\u00e9\u3000\ufeff\U0001f600");
    EXPECT_EQ(parsed.value().find("\u00fcber")->line, 2u);
    EXPECT_EQ(parsed.value().find("b")->text, "\u00a0c");
}

TEST(Toml, WhatIsNoUtf8IsRefusedWithItsPlace) {
    for (const char* bytes :
         {"\xff", "\x80", "\xc3", "\xc0\xaf", "\xe0\x80\x80", "\xed\xa0\x80", "\xf4\x90\x80\x80", "\xf0\x9f\x98"}) {
        std::string text = "a = 1\nb = '\u00e9";
        text.append(bytes).append("'");
        const auto parsed = parse_toml(text, "x.toml");
        ASSERT_FALSE(parsed) << bytes;
        EXPECT_EQ(parsed.fault().line(), "x.toml:2:7: not TOML: is not UTF-8; save the file as UTF-8");
    }
    EXPECT_EQ(parse_toml("a = '\U00100000'", "x.toml").fault().where, "x.toml:1:6");  // private use
}

TEST(Profile, StiffnessNeedsDampingOrAStatement) {
    const auto native = read_device_profile(std::string(kShipped) + "native.toml");
    ASSERT_TRUE(native);
    // b / (T/2 + t_d)
    EXPECT_NEAR(native.value().stability_limit_n_mm(0.0, 1e-3), 0.002 / 1.5e-3, 1e-12);
    const auto wooden = read_device_profile(std::string(kShipped) + "woodenhaptics_8.toml");
    ASSERT_TRUE(wooden);
    EXPECT_EQ(wooden.value().stability_limit_n_mm(0.0, 1e-3), 1.0);  // as stated
}

TEST(Crc16, HasTheStandardCheckValue) {
    const std::uint8_t digits[] = {'1', '2', '3', '4', '5', '6', '7', '8', '9'};
    EXPECT_EQ(crc16_ccitt(digits, 9), 0x29B1);
}

TEST(ReportLayout, WritesAndReadsEveryTypeInBothByteOrders) {
    for (const bool big : {false, true}) {
        for (const FieldType type : {FieldType::i8, FieldType::u8, FieldType::i16, FieldType::u16, FieldType::i32,
                                     FieldType::u32, FieldType::f32}) {
            ReportLayout layout;
            layout.bytes = 16;
            layout.big_endian = big;
            layout.fields[static_cast<std::size_t>(FieldName::force_n)] = Field{type, 3, 3, 0.5, 1.0};
            std::array<std::uint8_t, 16> bytes{};
            const double sent[3] = {1.0, 11.5, 33.0};
            ASSERT_TRUE(layout.write(bytes, FieldName::force_n, sent));
            double got[3];
            layout.read(bytes, FieldName::force_n, got);
            for (int i = 0; i < 3; ++i) EXPECT_EQ(got[i], sent[i]);
        }
    }
}

TEST(ReportLayout, BigEndianIsBigEndian) {
    ReportLayout layout;
    layout.bytes = 4;
    layout.big_endian = true;
    layout.fields[static_cast<std::size_t>(FieldName::seq)] = Field{FieldType::u32, 0, 1, 1.0, 0.0};
    std::array<std::uint8_t, 4> bytes{};
    layout.write_bits(bytes, FieldName::seq, 0x01020304u);
    EXPECT_EQ(bytes, (std::array<std::uint8_t, 4>{1, 2, 3, 4}));
}

TEST(ReportLayout, ClampsToItsTypeAndRefusesWhatIsNotFinite) {
    ReportLayout layout;
    layout.bytes = 8;
    layout.fields[static_cast<std::size_t>(FieldName::motor_ma)] = Field{FieldType::i16, 0, 3, 1.0, 0.0};
    std::array<std::uint8_t, 8> bytes{};
    const double large[3] = {1e6, -1e6, 12.6};
    EXPECT_TRUE(layout.write(bytes, FieldName::motor_ma, large));
    double got[3];
    layout.read(bytes, FieldName::motor_ma, got);
    EXPECT_EQ(got[0], 32767.0);
    EXPECT_EQ(got[1], -32768.0);
    EXPECT_EQ(got[2], 13.0);
    const double bad[3] = {0.0, NAN, 0.0};
    const auto before = bytes;
    EXPECT_FALSE(layout.write(bytes, FieldName::motor_ma, bad));
    EXPECT_EQ(bytes, before);
}

SerialPantograph wooden() {
    const auto profile = read_device_profile(std::string(kShipped) + "woodenhaptics_8.toml");
    return std::get<SerialPantograph>(profile.value().kinematics.form);
}

TEST(Pantograph, JacobianIsTheDerivativeOfThePosition) {
    const SerialPantograph form = wooden();
    const Triple q = {0.3, 0.7, 1.9};
    const auto jacobian = form.jacobian_mm(q);
    for (std::size_t i = 0; i < 3; ++i) {
        constexpr double h = 1e-6;
        Triple plus = q, minus = q;
        plus[i] += h;
        minus[i] -= h;
        const Triple a = form.position_mm(plus), b = form.position_mm(minus);
        for (std::size_t r = 0; r < 3; ++r) EXPECT_NEAR((a[r] - b[r]) / (2 * h), jacobian[3 * r + i], 1e-5);
    }
}

// Virtual work: what the motors give is what the tip gives, whatever the geometry.
TEST(Pantograph, MotorsDoTheWorkOfTheForce) {
    SerialPantograph form = wooden();
    form.sign = {1, -1, 1};
    form.max_current_ma = 1e9;
    const Triple counts = {120, -900, 3000}, force = {1.0, -0.5, 2.0};
    const Triple q = form.angles(counts), current = form.currents_ma(q, force);
    for (std::size_t i = 0; i < 3; ++i) {
        Triple moved = counts;
        moved[i] += 1e-3;
        const Triple a = form.position_mm(form.angles(moved)), b = form.position_mm(q);
        double work_mj = 0.0;
        for (std::size_t r = 0; r < 3; ++r) work_mj += force[r] * (a[r] - b[r]);
        // Torque at the motor's own shaft times its own turn.
        const double shaft_turn = 1e-3 * 2.0 * M_PI / form.counts_per_rev[i];
        const double motor_mj = current[i] * form.torque_constant_n_m_a[i] * shaft_turn;
        EXPECT_NEAR(motor_mj, work_mj, 1e-6 * std::abs(work_mj) + 1e-12) << i;
    }
}

TEST(Pantograph, CurrentsAreScaledTogether) {
    SerialPantograph form = wooden();
    const Triple q = form.angles({100, 2500, 500}), force = {40.0, -20.0, 80.0};
    form.max_current_ma = 1e9;
    const Triple free = form.currents_ma(q, force);
    form.max_current_ma = 2000.0;
    const Triple held = form.currents_ma(q, force);
    double most = 0.0;
    for (const double value : held) most = std::max(most, std::abs(value));
    EXPECT_NEAR(most, 2000.0, 1e-9);
    for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(held[i] / held[0], free[i] / free[0], 1e-9);
}

TEST(Kinematics, QuaternionOfAxesTurnsAsTheyDo) {
    const std::array<double, 9> turns[] = {{1, 0, 0, 0, 1, 0, 0, 0, 1},   {0, -1, 0, 1, 0, 0, 0, 0, 1},
                                           {1, 0, 0, 0, -1, 0, 0, 0, -1}, {-1, 0, 0, 0, 1, 0, 0, 0, -1},
                                           {-1, 0, 0, 0, -1, 0, 0, 0, 1}, {0, 0, 1, 1, 0, 0, 0, 1, 0}};
    for (const auto& m : turns) {
        const auto [w, x, y, z] = quaternion_of(m);
        EXPECT_NEAR(w * w + x * x + y * y + z * z, 1.0, 1e-12);
        const double back[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                                2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                                2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
        for (std::size_t i = 0; i < 9; ++i) EXPECT_NEAR(back[i], m[i], 1e-12);
    }
}

}  // namespace
}  // namespace hapticlod::station
