// The C ABI as a caller meets it.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <memory>

#include "bundle_maker.hpp"
#include "hapticlod/hapticlod.h"

namespace hapticlod {
namespace {

TEST(CApi, RendersTheGoldenRecordEvenAfterTheBundleIsClosed) {
    const test::TemporaryFile file(test::plate_bundle().sealed());
    hlod_bundle* bundle = nullptr;
    char message[256] = "x";
    ASSERT_EQ(hlod_bundle_open(file.path().c_str(), &bundle, message, sizeof(message)), HLOD_OK) << message;
    EXPECT_STREQ(message, "");
    hlod_info info{};
    info.struct_bytes = sizeof(info);
    ASSERT_EQ(hlod_bundle_info(bundle, &info), HLOD_OK);
    EXPECT_EQ(info.level_count, 2u);
    EXPECT_EQ(info.triangles[1], 18u);
    EXPECT_EQ(info.golden_ticks, 200u);
    EXPECT_STREQ(hlod_bundle_manifest(bundle), R"({"scan": "plate"})");

    hlod_renderer* renderer = nullptr;
    ASSERT_EQ(hlod_renderer_create(bundle, nullptr, &renderer, nullptr, 0), HLOD_OK);
    std::vector<std::array<double, 8>> motion(info.golden_ticks);
    std::vector<hlod_record> expected(info.golden_ticks);
    for (std::size_t i = 0; i < motion.size(); ++i) {
        ASSERT_EQ(hlod_bundle_golden(bundle, i, &motion[i][0], &motion[i][1], &motion[i][4], &expected[i]), HLOD_OK);
    }
    EXPECT_EQ(hlod_bundle_golden(bundle, motion.size(), nullptr, nullptr, nullptr, nullptr), HLOD_BAD_ARGUMENT);
    hlod_bundle_close(bundle);
    double most_n = 0.0;
    for (std::size_t i = 0; i < motion.size(); ++i) {
        hlod_record record;
        ASSERT_EQ(hlod_tick(renderer, motion[i][0], &motion[i][1], &motion[i][4], &record), HLOD_OK);
        EXPECT_EQ(std::memcmp(&record, &expected[i], sizeof(record)), 0) << i;
        most_n = std::max(most_n, std::hypot(record.force_n[0], record.force_n[1], record.force_n[2]));
    }
    EXPECT_NEAR(most_n, 0.4, 0.02);
    hlod_renderer_destroy(renderer);
}

TEST(CApi, OptionsChangeTheRendererWithinTheBundlesLimits) {
    const test::TemporaryFile file(test::plate_bundle().sealed());
    hlod_bundle* bundle = nullptr;
    ASSERT_EQ(hlod_bundle_open(file.path().c_str(), &bundle, nullptr, 0), HLOD_OK);
    const auto force_at_depth = [bundle](hlod_options options, double depth_mm) {
        hlod_renderer* renderer = nullptr;
        EXPECT_EQ(hlod_renderer_create(bundle, &options, &renderer, nullptr, 0), HLOD_OK);
        hlod_record record{};
        for (int i = 0; i < 100; ++i) {  // slowly, from above
            const double position[3] = {1.0, 1.0, 20.1 - (depth_mm + 0.1) * i / 99.0};
            hlod_tick(renderer, i * 1e-3, position, nullptr, &record);
        }
        hlod_renderer_destroy(renderer);
        return record.force_n[2];
    };
    EXPECT_NEAR(force_at_depth({sizeof(hlod_options), 0.0, 0.0, 0.0}, 0.5), 0.5, 1e-3);
    EXPECT_NEAR(force_at_depth({sizeof(hlod_options), 0.5, 0.0, 0.0}, 0.5), 0.25, 1e-3);
    EXPECT_NEAR(force_at_depth({sizeof(hlod_options), 0.0, 0.3, 0.0}, 0.5), 0.3, 1e-3);
    EXPECT_NEAR(force_at_depth({sizeof(hlod_options), 20.0, 100.0, 0.0}, 0.5), 4.0, 1e-3);  // never above the bundle's

    char message[64];
    hlod_renderer* renderer = nullptr;
    const hlod_options wrong{sizeof(hlod_options), NAN, 0.0, 0.0};
    EXPECT_EQ(hlod_renderer_create(bundle, &wrong, &renderer, message, sizeof(message)), HLOD_BAD_OPTION);
    EXPECT_EQ(renderer, nullptr);
    EXPECT_NE(std::string(message).find("stiffness_n_mm"), std::string::npos);
    hlod_bundle_close(bundle);
}

TEST(CApi, BadCallsAreRefused) {
    hlod_bundle* bundle = nullptr;
    char message[16];
    EXPECT_EQ(hlod_abi_version(), HLOD_ABI_VERSION);
    EXPECT_EQ(hlod_bundle_open("/nonexistent.hlod", &bundle, message, sizeof(message)), HLOD_BAD_BUNDLE);
    EXPECT_EQ(bundle, nullptr);
    EXPECT_STREQ(message, "/nonexistent.hl");  // cut to the buffer, terminated
    EXPECT_EQ(hlod_bundle_open(nullptr, &bundle, nullptr, 0), HLOD_BAD_ARGUMENT);
    EXPECT_EQ(hlod_bundle_open("x", nullptr, nullptr, 0), HLOD_BAD_ARGUMENT);
    EXPECT_EQ(hlod_bundle_info(nullptr, nullptr), HLOD_BAD_ARGUMENT);
    EXPECT_EQ(hlod_tick(nullptr, 0.0, nullptr, nullptr, nullptr), HLOD_BAD_ARGUMENT);
    hlod_bundle_close(nullptr);
    hlod_renderer_destroy(nullptr);
    hlod_reset(nullptr);
    hlod_set_coarsest_floor(nullptr, 1);

    const test::TemporaryFile file(test::plate_bundle().sealed());
    ASSERT_EQ(hlod_bundle_open(file.path().c_str(), &bundle, nullptr, 0), HLOD_OK);
    hlod_info info{};
    info.struct_bytes = 8;  // built against another header
    EXPECT_EQ(hlod_bundle_info(bundle, &info), HLOD_BAD_ARGUMENT);
    hlod_bundle_close(bundle);
}

TEST(CApi, OpensFromMemoryAndAsksWhomToTrust) {
    std::ifstream golden(HAPTICLOD_REPOSITORY "/tests/golden/format_1.hlod", std::ios::binary);
    const std::string bytes{std::istreambuf_iterator<char>(golden), {}};
    std::vector<std::max_align_t> storage((bytes.size() + 128) / sizeof(std::max_align_t));
    void* place = storage.data();
    std::size_t room = storage.size() * sizeof(std::max_align_t);
    ASSERT_NE(std::align(64, bytes.size() + 1, place, room), nullptr);
    std::memcpy(place, bytes.data(), bytes.size());
    hlod_bundle* bundle = nullptr;
    char message[256];
    EXPECT_EQ(hlod_bundle_open_memory(nullptr, 64, nullptr, &bundle, nullptr, 0), HLOD_BAD_ARGUMENT);
    EXPECT_EQ(hlod_bundle_open_memory(static_cast<char*>(place) + 1, bytes.size(), "odd", &bundle, message, 256),
              HLOD_BAD_BUNDLE);
    EXPECT_NE(std::string(message).find("odd: does not start at a multiple of 64"), std::string::npos);
    EXPECT_EQ(hlod_bundle_open_memory(place, 100, nullptr, &bundle, message, 256), HLOD_BAD_BUNDLE);
    EXPECT_EQ(bundle, nullptr);
    ASSERT_EQ(hlod_bundle_open_memory(place, bytes.size(), nullptr, &bundle, message, 256), HLOD_OK) << message;

    const std::string key = "ed25519 A6EHv/POEL4dcN0Y50vAmWfk1jCbpQ1fHdyGZBJVMbg= tests";
    const struct {
        std::string lines;
        hlod_status status;
        const char* said;
    } cases[] = {{key + "\n", HLOD_OK, "signed by tests, trusted"},
                 {key + " until=2001-01-01\n", HLOD_UNTRUSTED, "whose trust has expired"},
                 {"# nobody\n", HLOD_UNTRUSTED, "signed by a key that is not trusted here"},
                 {"nonsense\n", HLOD_BAD_ARGUMENT, ":1: is no line of a trusted key"}};
    for (const auto& one : cases) {
        const test::TemporaryFile file(one.lines);
        EXPECT_EQ(hlod_bundle_trusted(bundle, file.path().c_str(), message, sizeof(message)), one.status);
        EXPECT_NE(std::string(message).find(one.said), std::string::npos) << message;
    }
    EXPECT_EQ(hlod_bundle_trusted(bundle, "/nonexistent", message, sizeof(message)), HLOD_BAD_ARGUMENT);
    EXPECT_EQ(hlod_bundle_trusted(nullptr, nullptr, message, sizeof(message)), HLOD_BAD_ARGUMENT);
    hlod_bundle_close(bundle);
}

}  // namespace
}  // namespace hapticlod
