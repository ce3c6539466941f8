// Motion files, record files, JSON text, whole-file writing.
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <charconv>
#include <cmath>

#include "bundle_maker.hpp"
#include "io/atomic_file.hpp"
#include "io/json_text.hpp"
#include "io/motion_csv.hpp"
#include "io/motion_interpolation.hpp"
#include "io/record_csv.hpp"

namespace hapticlod {
namespace {

void expect_fault(std::string_view text, const std::string& expected) {
    const auto motion = parse_motion_csv(text, "probe.csv");
    ASSERT_FALSE(motion) << text;
    EXPECT_NE(motion.fault().line().find(expected), std::string::npos) << "said: " << motion.fault().line();
}

TEST(MotionCsv, ReadsColumnsByName) {
    const auto motion =
        parse_motion_csv("# a comment\n\nz_mm, t_s ,note,x_mm,y_mm\n3,0,a,1,2\r\n-3e0,+0.001,b,1.5,2.5\n", "probe.csv");
    ASSERT_TRUE(motion) << motion.fault().line();
    ASSERT_EQ(motion.value().size(), 2u);
    const MotionRow& row = motion.value()[1];
    EXPECT_EQ(row.time_s, 0.001);
    EXPECT_EQ(row.position_mm[0], 1.5);
    EXPECT_EQ(row.position_mm[1], 2.5);
    EXPECT_EQ(row.position_mm[2], -3.0);
    EXPECT_EQ(row.orientation[0], 1.0);
}

TEST(MotionCsv, ReadsOrientationsAndTabs) {
    const auto motion = parse_motion_csv(
        "\xef\xbb\xbft_s\tx_mm\ty_mm\tz_mm\tqw\tqx\tqy\tqz\n0\t0\t0\t0\t1\t0\t0\t0\n1\t0\t0\t0\t0.6\t0\t0.8\t0",
        "probe.tsv");
    ASSERT_TRUE(motion) << motion.fault().line();
    EXPECT_EQ(motion.value()[1].orientation[2], 0.8);
}

TEST(MotionCsv, SaysWhatIsWrongAndWhere) {
    const std::string head = "t_s,x_mm,y_mm,z_mm\n0,1,2,3\n";
    expect_fault("", "probe.csv: has no header");
    expect_fault("# only this\n", "probe.csv: has no header");
    expect_fault("0,1,2,3\n0.1,1,2,3\n", "probe.csv:1: has no header");
    expect_fault("t_s,x_mm,y_mm\n0,1,2\n", "probe.csv:1: has no column 'z_mm'");
    expect_fault("t_s,x_mm,y_mm,z_mm,qw\n", "probe.csv:1: has no column 'qx'");
    expect_fault("t_s,t_s,x_mm,y_mm,z_mm\n", "column 't_s' appears twice");
    expect_fault(head, "has 1 rows, a motion needs at least 2");
    expect_fault(head + "0.1,1,2\n", "probe.csv:3: has 3 fields, the header 4");
    expect_fault(head + "0.1,1,two,3\n", "probe.csv:3: y_mm is not a number ('two')");
    expect_fault(head + "0.1,1,2,3mm\n", "z_mm is not a number ('3mm')");
    expect_fault(head + "0.1,1,,3\n", "y_mm is not a number ('')");
    expect_fault(head + "0.1,nan,2,3\n", "probe.csv:3: x_mm is not finite ('nan')");
    expect_fault(head + "0.1,1,2,-inf\n", "z_mm is not finite");
    expect_fault(head + "0.1,1e999,2,3\n", "x_mm is not a number");
    expect_fault(head + "0.1,1,2,3\n0.1,1,2,3\n", "probe.csv:4: t_s does not increase");
    expect_fault("seg,t_s,x_mm,y_mm,z_mm\n7,0,1,2,3\n8,1,1,2,3\n", "probe.csv:3: a second segment begins");
    expect_fault("t_s,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n1,0,0,0,1,1,0,0\n", "unit quaternion");
    expect_fault(std::string("t_s,x_mm,y_mm,z_mm\n0,1,2,3\n\0\x01,1,2,3\n", 36), "probe.csv:3: t_s is not a number");
}

TEST(Motion, IsInterpolatedSmoothlyThroughItsRows) {
    std::vector<MotionRow> rows(50);
    for (std::size_t i = 0; i < rows.size(); ++i) {
        const double t = 0.02 * static_cast<double>(i);
        rows[i] = {t, {std::sin(5.0 * t), t, 2.0}, {std::cos(t), 0.0, std::sin(t), 0.0}};
    }
    EXPECT_EQ(sample_motion(rows, rows[17].time_s).position_mm[0], rows[17].position_mm[0]);
    for (double t = 0.03; t < 0.95; t += 0.0173) {
        const MotionSample sample = sample_motion(rows, t);
        EXPECT_NEAR(sample.position_mm[0], std::sin(5.0 * t), 1e-4);
        EXPECT_NEAR(sample.velocity_mm_s[0], 5.0 * std::cos(5.0 * t), 2e-2);
        EXPECT_NEAR(sample.velocity_mm_s[1], 1.0, 1e-12);
        EXPECT_NEAR(sample.orientation[2], std::sin(t), 1e-6);
    }
    EXPECT_TRUE(has_rate(rows, 50.0));
    EXPECT_FALSE(has_rate(rows, 51.0));
    const auto fine = resample_motion(rows, 1000.0);
    ASSERT_EQ(fine.size(), 981u);
    EXPECT_EQ(check_motion(fine), "");
    EXPECT_TRUE(has_rate(fine, 1000.0));
    EXPECT_EQ(fine[20].position_mm[0], rows[1].position_mm[0]);
}

TEST(RecordCsv, NumbersReadBackTheSameBits) {
    TickRecord row{};
    row.time_s = 0.1;
    row.hip_mm[1] = 1.0 / 3.0;
    row.force_n[2] = -1e-310;
    row.speed_mm_s = 0.1f;
    row.level = 3;
    row.mapping_cells = 4000000000u;
    const std::string text = record_csv(std::span(&row, 1));
    const std::size_t body = text.find('\n') + 1;
    std::vector<std::string> header, fields;
    for (auto [part, list] : {std::pair{text.substr(0, body), &header}, std::pair{text.substr(body), &fields}}) {
        for (std::size_t start = 0, stop = 0; stop != std::string::npos; start = stop + 1) {
            stop = part.find(',', start);
            list->push_back(part.substr(start, stop - start));
        }
    }
    ASSERT_EQ(header.size(), fields.size());
    const auto number = [&](const std::string& name, auto value) {
        for (std::size_t i = 0; i < header.size(); ++i) {
            if (header[i] == name) std::from_chars(fields[i].data(), fields[i].data() + fields[i].size(), value);
        }
        return value;
    };
    EXPECT_EQ(number("time_s", 0.0), 0.1);
    EXPECT_EQ(number("hip_y_mm", 0.0), 1.0 / 3.0);
    EXPECT_EQ(number("force_z_n", 0.0), -1e-310);
    EXPECT_EQ(number("speed_mm_s", 0.0f), 0.1f);
    EXPECT_EQ(number("level", 0u), 3u);
    EXPECT_EQ(header.back(), "mapping_cells\n");
}

TEST(AtomicFile, ReplacesWholeFilesOrSaysWhyNot) {
    const test::TemporaryFile file("old");
    ASSERT_EQ(::chmod(file.path().c_str(), 0640), 0);
    ASSERT_FALSE(write_file_atomic(file.path(), "new content"));
    std::string content;
    std::getline(std::ifstream(file.path()), content);
    EXPECT_EQ(content, "new content");
    struct stat status {};
    ASSERT_EQ(::stat(file.path().c_str(), &status), 0);
    EXPECT_EQ(status.st_mode & 0777, 0640u);
    const auto fault = write_file_atomic("/nonexistent/out.csv", "x");
    ASSERT_TRUE(fault);
    EXPECT_NE(fault->line().find("/nonexistent/out.csv: cannot be written"), std::string::npos);
    EXPECT_TRUE(write_file_atomic("/tmp", "x"));
}

TEST(JsonText, WritesWhatItAccepts) {
    JsonWriter json;
    json.open('{').field("a", 0.1).field("quote\"\n", true).key("list").open('[').value(1u).value("x").close();
    json.field("nan", NAN).key("raw").raw("{}").close();
    EXPECT_EQ(json.text(), R"({"a":0.1,"quote\"\u000a":true,"list":[1,"x"],"nan":null,"raw":{}})");
    EXPECT_TRUE(is_json_object(json.text()));
}

TEST(JsonText, AcceptsJsonAndNothingElse) {
    for (const char* good :
         {"{}", " { \"a\" : [1, -0.5e+3, true, false, null, \"\\u00e9\\n\xc3\xa9\", {}] } ", "{\"a\":{\"b\":[[]]}}"}) {
        EXPECT_TRUE(is_json_object(good)) << good;
    }
    for (const char* bad :
         {"", "[]", "{", "{}x", "{\"a\"}", "{\"a\":}", "{\"a\":01}", "{\"a\":.5}", "{\"a\":1,}", "{\"a\":NaN}",
          "{\"a\":\"\\x\"}", "{\"a\":\"\n\"}", "{\"a\":\"\xff\"}", "{\"a\":\"\xc3\"}", "{\"a\":\"\xed\xa0\x80\"}",
          "{'a':1}", "{\"a\":\"\\u12g4\"}", "{\"a\":\"b}", "{\"a\":tru}"}) {
        EXPECT_FALSE(is_json_object(bad)) << bad;
    }
    EXPECT_FALSE(is_json_object("{\"a\":" + std::string(100000, '[')));
}

}  // namespace
}  // namespace hapticlod
