// Opening quickly: bounds of blocks from the file, large arrays checked by several threads, files that are known.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>

#include "bundle_maker.hpp"
#include "bundle_verdicts.hpp"
#include "io/bundle.hpp"

namespace hapticlod {
namespace {

using test::expect_golden;
using test::expect_refused;
using test::MadeBundle;
using test::plate_bundle;
using test::refusal;
using test::TemporaryFile;

TEST(Bounds, AreUsedInPlaceAndMadeWhereTheyAreMissingOrNew) {
    MadeBundle made = plate_bundle();
    const TemporaryFile file(made.sealed());
    const auto stored = Bundle::open(file.path());
    ASSERT_TRUE(stored) << stored.fault().line();
    const LevelView& level = stored.value().levels()[1];
    EXPECT_EQ(level.bounds.size(), level.blocks.size());
    const ActiveLevel active(level);
    EXPECT_EQ(active.bounds.data(), level.bounds.data());
    expect_golden(stored.value());

    made.at(SectionType::bounds).version = 2;
    const TemporaryFile newer(made.sealed());
    const auto made_anew = Bundle::open(newer.path());
    ASSERT_TRUE(made_anew) << made_anew.fault().line();
    EXPECT_TRUE(made_anew.value().levels()[0].bounds.empty());
    expect_golden(made_anew.value());

    made = plate_bundle();  // of a level that is rebuilt, and so of no use
    made.at(SectionType::bricks, 0).version = 9;
    const TemporaryFile rebuilt(made.sealed());
    const auto without = Bundle::open(rebuilt.path());
    ASSERT_TRUE(without) << without.fault().line();
    EXPECT_TRUE(without.value().levels()[1].bounds.empty());
    expect_golden(without.value());
}

TEST(Bounds, ThatDoNotHoldAreRefused) {
    const auto wrong = [](auto change) {
        MadeBundle made = plate_bundle();
        change(made.as<BlockBound>(SectionType::bounds)[3]);
        return made.sealed();
    };
    EXPECT_EQ(refusal(wrong([](BlockBound& b) { b.radius *= 2.0f; })), "");  // slower, not wrong
    expect_refused(wrong([](BlockBound& b) { b.radius *= 0.5f; }), "level 0: a block reaches beyond its bound");
    expect_refused(wrong([](BlockBound& b) { b.half = -1.0f; }), "a block reaches beyond its bound");
    expect_refused(wrong([](BlockBound& b) { b.x = NAN; }), "a block reaches beyond its bound");
    expect_refused(wrong([](BlockBound& b) { b.radius = INFINITY; }), "is no disc");
    expect_refused(wrong([](BlockBound& b) { b.half = NAN; }), "is no disc");
    expect_refused(wrong([](BlockBound& b) { b.nz = 0.9f; }), "is no disc");
    MadeBundle made = plate_bundle();
    made.at(SectionType::bounds).bytes.resize(32);
    expect_refused(made.sealed(), "section BOUNDS and the blocks of all levels differ in number");
    made.at(SectionType::bounds).bytes.resize(33);
    expect_refused(made.sealed(), "no multiple of 32");
}

// Large enough that arrays are left to threads: 7 MB.
const MadeBundle& large_bundle() {
    static const MadeBundle made = plate_bundle(true, 200);
    return made;
}

TEST(LargeBundle, DamageInAnyArrayIsFoundAndNamed) {
    const std::string right = large_bundle().sealed();
    ASSERT_EQ(refusal(right), "");
    int large = 0;
    for (std::uint32_t place = sizeof(BundleHeader);; place += sizeof(SectionEntry)) {
        SectionEntry entry;
        std::memcpy(&entry, &right[place], sizeof(entry));
        const Section section{entry, std::as_bytes(std::span(right)).subspan(entry.offset, entry.length)};
        if (section.large()) {
            ++large;
            std::string wrong = right;
            wrong[entry.offset + entry.length / 2 + 1] ^= 0x10;
            expect_refused(wrong, section.name() + ": is damaged (its digest differs)");
        }
        if (entry.offset + entry.length == right.size()) break;
    }
    EXPECT_GE(large, 10);
}

TEST(LargeBundle, SealedWrongContentIsFoundAndTheFirstFaultNamed) {
    MadeBundle made = large_bundle();
    made.as<TriBlock>(SectionType::blocks, 0)[9000].v[4][2] += 1.0f;
    expect_refused(made.sealed(), "level 0: a block's corners differ from the mesh");
    made.as<std::uint32_t>(SectionType::adjacency, 0)[90'000] = 80'000;
    expect_refused(made.sealed(), "level 0: a neighbour index is out of range");
    made = large_bundle();
    made.as<std::uint32_t>(SectionType::faces, 1)[50'000] = 0xffffffff;  // blocks read it in another thread
    expect_refused(made.sealed(), "level 1: a face index is out of range");
    made.as<float>(SectionType::vertices, 1)[20'000] = NAN;
    expect_refused(made.sealed(), "level 1: a vertex is not finite");
    made = large_bundle();
    made.as<Material>(SectionType::materials, 0)[30'000].stiffness_n_mm = 0.0f;
    expect_refused(made.sealed(), "level 0: a material's stiffness");
    made = large_bundle();
    made.as<std::uint32_t>(SectionType::cells, 0)[1000] = 0;
    expect_refused(made.sealed(), "level 0: a cell's blocks are out of order");
}

class Known : public ::testing::Test {
protected:
    // Whether it was known, and the fault where it was refused.
    std::string opened(std::int64_t settled_ns = 0) {
        CheckedFiles known(record_, settled_ns);
        const auto bundle = Bundle::open(file_.path(), known);
        if (!bundle) return bundle.fault().line();
        expect_golden(bundle.value());
        return bundle.value().checked_before() ? "known" : "checked";
    }
    [[nodiscard]] std::string record_text() const {
        std::ifstream file(record_);
        return {std::istreambuf_iterator<char>(file), {}};
    }
    void write_record(const std::string& text) const { std::ofstream(record_, std::ios::trunc) << text; }
    ~Known() override { std::filesystem::remove_all(folder_.path() + ".d"); }

    const std::string right_ = large_bundle().sealed();
    TemporaryFile file_{right_}, folder_{""};
    const std::string record_ = folder_.path() + ".d/cache/checked_bundles";  // its folder is made
};

TEST_F(Known, AFileIsReadWholeOnceAndTheRecordIsItsOwners) {
    EXPECT_EQ(opened(), "checked");
    EXPECT_EQ(opened(), "known");
    struct stat status {};
    ASSERT_EQ(::stat(record_.c_str(), &status), 0);
    EXPECT_EQ(status.st_mode & 0777, 0600u);
    EXPECT_TRUE(Bundle::open(file_.path()));  // without a record: all of it
    EXPECT_FALSE(Bundle::open(file_.path()).value().checked_before());
}

TEST_F(Known, AFileThatWasWrittenIsReadAgainWhateverItsTimesSay) {
    ASSERT_EQ(opened(), "checked");
    struct stat before {};
    ASSERT_EQ(::stat(file_.path().c_str(), &before), 0);
    SectionEntry last;
    std::memcpy(&last, &right_[sizeof(BundleHeader) + 11 * sizeof(SectionEntry)], sizeof(last));
    const int file = ::open(file_.path().c_str(), O_WRONLY | O_CLOEXEC);
    ASSERT_GE(file, 0);
    const char wrong = static_cast<char>(right_[last.offset + 100'000] ^ 1);
    ASSERT_EQ(::pwrite(file, &wrong, 1, static_cast<off_t>(last.offset + 100'000)), 1);
    const struct timespec times[2] = {before.st_atim, before.st_mtim};
    ASSERT_EQ(::futimens(file, times), 0);  // as whoever hides a change would
    ::close(file);
    EXPECT_NE(opened().find("is damaged (its digest differs)"), std::string::npos);
    std::ofstream(file_.path(), std::ios::binary) << right_;
    EXPECT_EQ(opened(), "checked");
    EXPECT_EQ(opened(), "known");
    // Another file in its place, of the same size and with the same front.
    std::string other = right_;
    other[last.offset + 100'000] ^= 1;
    std::ofstream(file_.path() + ".new", std::ios::binary) << other;
    std::filesystem::rename(file_.path() + ".new", file_.path());
    EXPECT_NE(opened().find("is damaged (its digest differs)"), std::string::npos);
}

TEST_F(Known, WhatOthersCanWriteIsNeverKnown) {
    ASSERT_EQ(::chmod(file_.path().c_str(), 0664), 0);
    EXPECT_EQ(opened(), "checked");
    EXPECT_EQ(opened(), "checked");
    ASSERT_EQ(::chmod(file_.path().c_str(), 0644), 0);
    EXPECT_EQ(opened(), "checked");
    EXPECT_EQ(opened(), "known");
    ASSERT_EQ(::chmod(record_.c_str(), 0620), 0);
    EXPECT_EQ(opened(), "checked");  // and its record is kept anew
    EXPECT_EQ(opened(), "known");
    const std::string text = record_text();
    std::filesystem::rename(record_, record_ + ".moved");
    std::filesystem::create_symlink(record_ + ".moved", record_);
    EXPECT_EQ(opened(), "checked");
}

TEST_F(Known, AFileThatChangedJustNowIsNotRemembered) {
    EXPECT_EQ(opened(3'600'000'000'000), "checked");
    EXPECT_EQ(opened(3'600'000'000'000), "checked");
}

TEST_F(Known, RecordsOfAnotherStartOrDamagedOnesCountAsNone) {
    ASSERT_EQ(opened(), "checked");
    const std::string right = record_text();
    std::string other = right;
    const std::size_t start = other.find('\n') + 1;
    other[start] = other[start] == '0' ? '1' : '0';
    for (const std::string& text :
         {other, std::string("checked\n") + right, right.substr(0, right.size() - 2), std::string(), right + right,
          right.substr(0, right.size() - 1) + " 7\n", right.substr(0, right.size() - 3) + "zz\n"}) {
        write_record(text);
        const bool whole = text.starts_with(right);
        EXPECT_EQ(opened(), whole ? "known" : "checked") << text;
    }
    EXPECT_EQ(opened(), "known");
}

TEST_F(Known, TheRecordDoesNotGrow) {
    CheckedFiles known(record_, 0);
    FileState state = *file_state(file_.path());
    for (int i = 0; i < 100; ++i) {
        ++state.inode;
        known.remember(state, {}, state.changed_ns + 1);
    }
    const std::string text = record_text();
    EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 2 + 32);
    EXPECT_TRUE(CheckedFiles(record_).knows(state, {}));
    EXPECT_FALSE(CheckedFiles(record_).knows(state, {1}));
    state.inode -= 40;
    EXPECT_FALSE(CheckedFiles(record_).knows(state, {}));
}

TEST_F(Known, WithoutAPlaceForTheRecordAllIsReadAlways) {
    CheckedFiles nowhere("/proc/hapticlod/checked_bundles", 0);
    EXPECT_TRUE(Bundle::open(file_.path(), nowhere));
    CheckedFiles again("/proc/hapticlod/checked_bundles", 0);
    EXPECT_FALSE(Bundle::open(file_.path(), again).value().checked_before());
}

}  // namespace
}  // namespace hapticlod
