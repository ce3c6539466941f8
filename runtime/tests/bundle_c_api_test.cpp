// The C ABI as a caller meets it.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <thread>

#include "bundle_maker.hpp"
#include "hapticlod/hapticlod.h"
#include "io/checked_files.hpp"

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

std::string text_of(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
}

// A bundle with one bit wrong where only reading a large array whole can tell. That the library takes it shows that it
// believed a record; that it refuses it, that it read.
class CApiKnown : public ::testing::Test {
protected:
    CApiKnown() { make_record({state_, head()}); }
    ~CApiKnown() override { std::filesystem::remove(record_); }

    // The record that an opening would have left which found this file right.
    struct Checked {
        FileState state;
        Digest head;
    };
    void make_record(const Checked& checked) const {
        std::filesystem::remove(record_);
        CheckedFiles(record_, 0).remember(checked.state, checked.head, checked.state.changed_ns + 1);
    }
    // Of the front of the file, up to the longest section table.
    [[nodiscard]] Digest head() const {
        const std::size_t most = sizeof(BundleHeader) + kMaxSections * sizeof(SectionEntry);
        return blake2b_256(std::as_bytes(std::span(content_)).first(std::min(content_.size(), most)));
    }
    [[nodiscard]] std::string opened(const char* record_path) const {
        hlod_bundle* bundle = nullptr;
        char message[256];
        const hlod_status status =
            hlod_bundle_open_known(file_.path().c_str(), record_path, &bundle, message, sizeof(message));
        EXPECT_EQ(bundle != nullptr, status == HLOD_OK);
        hlod_bundle_close(bundle);
        return status == HLOD_OK ? "taken" : message;
    }
    [[nodiscard]] std::string opened() const { return opened(record_.c_str()); }

    static std::string damaged() {
        std::string content = test::plate_bundle(false, 60).sealed();
        SectionEntry entry{};  // BLOCKS of level 0, the largest
        for (std::size_t i = 0; entry.type != static_cast<std::uint32_t>(SectionType::blocks); ++i)
            std::memcpy(&entry, &content[sizeof(BundleHeader) + i * sizeof(entry)], sizeof(entry));
        content[entry.offset + entry.length / 2] ^= 1;
        return content;
    }

    const std::string content_ = damaged();
    const test::TemporaryFile file_{content_};
    const FileState state_ = *file_state(file_.path());
    const std::string record_ = file_.path() + ".record";
};

constexpr const char* kDamaged = "BLOCKS of level 0: is damaged (its digest differs)";

TEST_F(CApiKnown, BelievesItsRecordOfAnUnchangedFile) {
    EXPECT_EQ(opened(), "taken");
    std::filesystem::remove(record_);
    EXPECT_NE(opened().find(kDamaged), std::string::npos);
    EXPECT_FALSE(std::filesystem::exists(record_));  // a refused file leaves none
    hlod_bundle* bundle = nullptr;
    EXPECT_EQ(hlod_bundle_open(file_.path().c_str(), &bundle, nullptr, 0), HLOD_BAD_BUNDLE);
}

TEST_F(CApiKnown, ReadsAgainWhateverWasWritten) {
    // The same byte again, with the old time of modification: the time of change tells, once its clock has moved on.
    const struct stat before = [this] {
        struct stat status {};
        ::stat(file_.path().c_str(), &status);
        return status;
    }();
    const int file = ::open(file_.path().c_str(), O_WRONLY | O_CLOEXEC);
    ASSERT_GE(file, 0);
    do {
        ASSERT_EQ(::pwrite(file, &content_.back(), 1, static_cast<off_t>(content_.size() - 1)), 1);
        const struct timespec times[2] = {before.st_atim, before.st_mtim};
        ASSERT_EQ(::futimens(file, times), 0);
    } while (*file_state(file_.path()) == state_);
    ::close(file);
    EXPECT_EQ(file_state(file_.path())->modified_ns, state_.modified_ns);
    EXPECT_NE(opened().find(kDamaged), std::string::npos);
}

TEST_F(CApiKnown, AForeignOrCutRecordCountsAsNone) {
    const std::string right = text_of(record_);
    ASSERT_EQ(opened(), "taken");
    std::string other_start = right;
    char& letter = other_start[other_start.find('\n') + 1];
    letter = letter == '0' ? '1' : '0';
    for (const std::string& text : {other_start, right.substr(0, right.size() - 2), right.substr(0, right.size() / 2),
                                    std::string("hapticlod checked bundles 2") + right.substr(right.find('\n')),
                                    std::string("\0\0", 2), std::string()}) {
        std::ofstream(record_, std::ios::trunc | std::ios::binary) << text;
        EXPECT_NE(opened().find(kDamaged), std::string::npos) << text;
    }
    FileState other = state_;
    ++other.inode;
    Digest other_head = head();
    other_head[0] ^= 1;
    for (const Checked& checked : {Checked{other, head()}, Checked{state_, other_head}}) {
        make_record(checked);
        EXPECT_NE(opened().find(kDamaged), std::string::npos);
    }
    make_record({state_, head()});
    ASSERT_EQ(opened(), "taken");
    ASSERT_EQ(::chmod(record_.c_str(), 0620), 0);  // others could have written it
    EXPECT_NE(opened().find(kDamaged), std::string::npos);
    EXPECT_NE(opened("/proc/nowhere/record").find(kDamaged), std::string::npos);
}

TEST_F(CApiKnown, RemembersWhatItFoundRightInTheUsersFolder) {
    const test::TemporaryFile right(test::plate_bundle(false, 60).sealed());
    const std::string folder = right.path() + ".d";
    ASSERT_EQ(::setenv("HAPTICLOD_CACHE", folder.c_str(), 1), 0);
    const auto open = [&right] {
        hlod_bundle* bundle = nullptr;
        EXPECT_EQ(hlod_bundle_open_known(right.path().c_str(), nullptr, &bundle, nullptr, 0), HLOD_OK);
        hlod_bundle_close(bundle);
    };
    open();
    EXPECT_FALSE(std::filesystem::exists(folder));  // it changed just now
    std::this_thread::sleep_for(std::chrono::milliseconds(2100));
    open();
    struct stat status {};
    ASSERT_EQ(::stat((folder + "/checked_bundles").c_str(), &status), 0);
    EXPECT_EQ(status.st_mode & 0777, 0600u);
    const std::string text = text_of(folder + "/checked_bundles");
    EXPECT_NE(text.find(" " + std::to_string(file_state(right.path())->inode) + " "), std::string::npos);
    open();
    EXPECT_EQ(text_of(folder + "/checked_bundles"), text);
    ::unsetenv("HAPTICLOD_CACHE");
    std::filesystem::remove_all(folder);
    hlod_bundle* bundle = nullptr;
    EXPECT_EQ(hlod_bundle_open_known(nullptr, nullptr, &bundle, nullptr, 0), HLOD_BAD_ARGUMENT);
    EXPECT_EQ(hlod_bundle_open_known("x", nullptr, nullptr, nullptr, 0), HLOD_BAD_ARGUMENT);
}

}  // namespace
}  // namespace hapticlod
