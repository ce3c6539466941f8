// The bundle reader: what is right is used in place, what is wrong is refused or harmless.
#include "io/bundle.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <memory>

#include "bundle_maker.hpp"
#include "bundle_verdicts.hpp"

namespace hapticlod {
namespace {

using test::expect_refused;
using test::MadeBundle;
using test::plate_bundle;
using test::refusal;
using test::TemporaryFile;

// The golden motion through the bundle's levels gives finite forces within the limit.
void expect_harmless(const Bundle& bundle) {
    Renderer renderer;
    if (!renderer.load(bundle.config(), bundle.levels(), bundle.tool()).empty()) return;
    for (const TickRecord& record : test::render(
             renderer, bundle.golden_motion().first(std::min<std::size_t>(40, bundle.golden_motion().size())))) {
        const double force = std::hypot(record.force_n[0], record.force_n[1], record.force_n[2]);
        ASSERT_TRUE(force <= bundle.config().max_force_n * (1.0 + 1e-12)) << force;
    }
}

TEST(Bundle, IsUsedInPlace) {
    const TemporaryFile file(plate_bundle().sealed());
    const auto opened = Bundle::open(file.path());
    ASSERT_TRUE(opened) << opened.fault().line();
    const Bundle& bundle = opened.value();
    EXPECT_EQ(bundle.manifest(), R"({"scan": "plate"})");
    ASSERT_EQ(bundle.levels().size(), 2u);
    EXPECT_EQ(bundle.levels()[0].triangle_count(), 72u);
    EXPECT_EQ(bundle.levels()[1].triangle_count(), 18u);
    EXPECT_EQ(bundle.golden_motion().size(), 200u);
    EXPECT_FALSE(bundle.rebuilt(0));
    for (const Section& section : bundle.sections()) {
        EXPECT_EQ(reinterpret_cast<std::uintptr_t>(section.bytes.data()) % 64, 0u) << section.name();
    }
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(bundle.levels()[1].blocks.data()) % 64, 0u);
}

TEST(Bundle, GoldenRecordIsRenderedAgainBitForBit) {
    const TemporaryFile file(plate_bundle().sealed());
    auto opened = Bundle::open(file.path());
    ASSERT_TRUE(opened);
    const Bundle bundle = std::move(opened).value();  // views survive the move
    Renderer renderer;
    ASSERT_EQ(renderer.load(bundle.config(), bundle.levels(), bundle.tool()), "");
    const auto records = test::render(renderer, bundle.golden_motion());
    std::size_t contacts = 0, coarse = 0;
    for (std::size_t i = 0; i < records.size(); ++i) {
        EXPECT_EQ(std::memcmp(&records[i], &bundle.golden_record()[i], sizeof(TickRecord)), 0) << i;
        contacts += records[i].contact;
        coarse += records[i].level;
    }
    EXPECT_GT(contacts, 50u);
    EXPECT_GT(coarse, 20u);
}

TEST(Bundle, MissingAndStrangeFilesAreRefused) {
    const auto missing = Bundle::open("/nonexistent/jaw.hlod");
    ASSERT_FALSE(missing);
    EXPECT_NE(missing.fault().line().find("/nonexistent/jaw.hlod: cannot be opened"), std::string::npos);
    ASSERT_FALSE(Bundle::open("/tmp"));
    expect_refused("", "is empty");
    expect_refused("solid plate\n", "cut short");
    expect_refused(std::string(100, 'x'), "is not a HapticLOD bundle");
}

TEST(Bundle, NewerFormatsAreRefusedByName) {
    std::string file = plate_bundle().sealed();
    file[8] = 2;
    expect_refused(file, "bundle format 2, this program reads format 1");
    MadeBundle made = plate_bundle();
    made.at(SectionType::config).version = 7;
    expect_refused(made.sealed(), "CONFIG: is needed and has version 7");
    made = plate_bundle();
    made.sections.push_back({static_cast<SectionType>(77), 0, "new", 1, 0});
    expect_refused(made.sealed(), "section type 77: is needed");
}

TEST(Bundle, UnknownOptionalSectionsAreSkipped) {
    MadeBundle made = plate_bundle();
    made.sections.push_back({static_cast<SectionType>(77), 0, "new", 3, kSectionOptional});
    made.sections.push_back({SectionType::signature, 0, "signed in a way of the future", 2, kSectionOptional});
    EXPECT_EQ(refusal(made.sealed()), "");
}

TEST(Bundle, WrongSignaturesAreRefused) {
    MadeBundle made = plate_bundle();
    made.at(SectionType::signature) = {SectionType::signature, 0, std::string(96, 's'), 1, kSectionOptional};
    expect_refused(made.sealed(), "SIGNATURE: does not verify");
    made.at(SectionType::signature).bytes.pop_back();
    expect_refused(made.sealed(), "SIGNATURE: has 95 bytes, expected 96");
}

// Bytes that were written once and must stay readable; tests/golden_bundle.py made them.
TEST(Bundle, FormatOneIsReadInMemoryAndEveryChangeOfWhatIsSignedIsRefused) {
    const Result<MappedFile> golden = MappedFile::open(HAPTICLOD_REPOSITORY "/tests/golden/format_1.hlod");
    ASSERT_TRUE(golden) << golden.fault().line();
    const auto bytes = golden.value().bytes();
    // Exactly as large as the file, so that a sanitizer sees the first byte that is read beyond it.
    void* memory = nullptr;
    ASSERT_EQ(::posix_memalign(&memory, 64, bytes.size()), 0);
    const std::unique_ptr<std::byte[], decltype(&std::free)> copy(static_cast<std::byte*>(memory), &std::free);
    std::memcpy(copy.get(), bytes.data(), bytes.size());
    const std::span<std::byte> file(copy.get(), bytes.size());
    const auto opened = Bundle::open(file, "golden");
    ASSERT_TRUE(opened) << opened.fault().line();
    ASSERT_TRUE(opened.value().signer());
    EXPECT_EQ(base64(*opened.value().signer()), "A6EHv/POEL4dcN0Y50vAmWfk1jCbpQ1fHdyGZBJVMbg=");
    EXPECT_EQ(opened.value().levels()[0].triangle_count(), 8u);
    expect_harmless(opened.value());
    for (std::size_t place = 0; place < file.size();
         place += place < 64 + 26 * 64 || place + 96 >= file.size() ? 1 : 31) {
        file[place] ^= std::byte{0x04};
        EXPECT_FALSE(Bundle::open(file, "golden")) << place;
        file[place] ^= std::byte{0x04};
    }
    EXPECT_FALSE(Bundle::open(file.subspan(1), "unaligned"));
}

TEST(Bundle, UnknownAccelerationIsRebuiltAndRendersTheSame) {
    MadeBundle made = plate_bundle();
    made.at(SectionType::bricks, 0).version = 9;
    made.at(SectionType::bricks, 0).bytes = "a layout of the future";
    std::erase_if(made.sections, [](const auto& s) { return s.type == SectionType::normals && s.level == 1; });
    const TemporaryFile file(made.sealed());
    const auto opened = Bundle::open(file.path());
    ASSERT_TRUE(opened) << opened.fault().line();
    const Bundle& bundle = opened.value();
    EXPECT_TRUE(bundle.rebuilt(0));
    EXPECT_TRUE(bundle.rebuilt(1));
    Renderer renderer;
    ASSERT_EQ(renderer.load(bundle.config(), bundle.levels(), bundle.tool()), "");
    const auto records = test::render(renderer, bundle.golden_motion());
    for (std::size_t i = 0; i < records.size(); ++i) {
        ASSERT_EQ(std::memcmp(&records[i], &bundle.golden_record()[i], sizeof(TickRecord)), 0) << i;
    }
}

TEST(Bundle, EveryTruncationIsRefused) {
    const std::string file = plate_bundle().sealed();
    for (std::size_t length = 0; length < file.size(); length += length < 300 ? 1 : 97) {
        ASSERT_NE(refusal(file.substr(0, length)), "") << length;
    }
    expect_refused(file + std::string(64, '\0'), "cut short or damaged");
}

TEST(Bundle, EveryFlippedByteIsRefused) {
    const std::string file = plate_bundle().sealed();
    for (std::size_t place = 0; place < file.size(); place += place < 2500 ? 1 : 61) {
        std::string flipped = file;
        flipped[place] = static_cast<char>(flipped[place] ^ 0x20);
        ASSERT_NE(refusal(flipped), "") << place;
    }
}

// A file whose digests are right and whose content is not: nobody's accident, but somebody's attempt.
TEST(Bundle, SealedWrongIndicesAreRefusedOrHarmless) {
    const MadeBundle right = plate_bundle();
    std::size_t taken = 0, refused = 0;
    for (std::size_t s = 0; s < right.sections.size(); ++s) {
        const SectionType type = right.sections[s].type;
        if (right.sections[s].level != 1 || !is_level_section(static_cast<std::uint32_t>(type))) continue;
        const std::size_t step = type == SectionType::blocks ? 7 : 1;
        for (std::size_t place = 0; place < right.sections[s].bytes.size(); place += step) {
            MadeBundle wrong = right;
            char& byte = wrong.sections[s].bytes[place];
            byte = static_cast<char>(~byte);
            const TemporaryFile file(wrong.sealed());
            const auto bundle = Bundle::open(file.path());
            ++(bundle ? taken : refused);
            if (bundle) expect_harmless(bundle.value());
        }
    }
    EXPECT_GT(refused, 500u);
    EXPECT_GT(taken, 10u);  // a moved vertex or a turned normal is a bundle like any other
}

TEST(Bundle, LengthsAreNotTrusted) {
    const MadeBundle made = plate_bundle();
    const auto spoiled = [&made](SectionType type, auto change) {
        return made.sealed([&](SectionEntry& entry) {
            if (entry.type == static_cast<std::uint32_t>(type)) change(entry);
        });
    };
    expect_refused(spoiled(SectionType::faces, [](SectionEntry& e) { e.length = 4ull << 30; }), "beyond the file");
    expect_refused(spoiled(SectionType::faces, [](SectionEntry& e) { e.length = ~0ull; }), "beyond the file");
    expect_refused(spoiled(SectionType::faces, [](SectionEntry& e) { e.offset = ~0ull - 63; }), "does not start");
    expect_refused(spoiled(SectionType::faces, [](SectionEntry& e) { e.offset -= 64; }), "does not start");
    expect_refused(spoiled(SectionType::faces, [](SectionEntry& e) { e.level = 8; }), "wrong level");
    expect_refused(spoiled(SectionType::faces, [](SectionEntry& e) { e.flags = 2; }), "unknown flags");
    expect_refused(spoiled(SectionType::tool, [](SectionEntry& e) { e.type = 2; }), "appears twice");
}

TEST(Bundle, ContentIsChecked) {
    const auto wrong = [](auto change) {
        MadeBundle made = plate_bundle();
        change(made);
        return made.sealed();
    };
    expect_refused(wrong([](MadeBundle& b) { b.as<float>(SectionType::vertices, 1)[4] = NAN; }), "finite");
    expect_refused(wrong([](MadeBundle& b) { b.as<std::uint32_t>(SectionType::faces, 0)[5] = 49; }), "out of range");
    expect_refused(wrong([](MadeBundle& b) { b.at(SectionType::faces, 0).bytes.pop_back(); }), "no multiple of 4");
    expect_refused(wrong([](MadeBundle& b) {
                       auto* config = b.as<ConfigData>(SectionType::config);
                       config->level_count = 3;
                       config->speeds_mm_s[1] = 50.0;
                       config->balls[2] = 1;
                   }),
                   "VERTICES of level 2 is missing");
    expect_refused(wrong([](MadeBundle& b) { b.as<ConfigData>(SectionType::config)->level_count = 1; }), "no level");
    expect_refused(wrong([](MadeBundle& b) { b.as<ConfigData>(SectionType::config)->stiffness_n_mm = NAN; }),
                   "stiffness_n_mm");
    expect_refused(wrong([](MadeBundle& b) { b.as<ConfigData>(SectionType::config)->reserved[3] = 1; }), "reserved");
    expect_refused(wrong([](MadeBundle& b) { b.as<ConfigData>(SectionType::config)->triangles[1] = 5; }),
                   "config says");
    expect_refused(wrong([](MadeBundle& b) { b.as<ConfigData>(SectionType::config)->balls[1] = 2; }), "more balls");
    expect_refused(wrong([](MadeBundle& b) { b.as<ConfigData>(SectionType::config)->cell_mm[1] = 2; }), "cell_mm");
    expect_refused(wrong([](MadeBundle& b) { b.as<HashHeader>(SectionType::hash)->reserved[4] = 1; }), "reserved");
    expect_refused(wrong([](MadeBundle& b) { b.as<BallData>(SectionType::tool)->radius_mm = -1; }), "radius");
    expect_refused(wrong([](MadeBundle& b) { b.at(SectionType::tool).bytes.clear(); }), "0 balls");
    expect_refused(wrong([](MadeBundle& b) { b.as<MotionRow>(SectionType::golden_motion)[9].time_s = 0; }), "row 10");
    expect_refused(wrong([](MadeBundle& b) { b.as<TickRecord>(SectionType::golden_record)[9].level = 2; }), "row 10");
    expect_refused(wrong([](MadeBundle& b) { b.at(SectionType::golden_record).bytes.resize(144); }), "1 rows");
    expect_refused(wrong([](MadeBundle& b) { b.at(SectionType::manifest).bytes = R"({"a": 1} x)"; }), "MANIFEST");
    expect_refused(wrong([](MadeBundle& b) {
                       std::erase_if(b.sections,
                                     [](auto& s) { return s.type == SectionType::vertices && s.level == 1; });
                   }),
                   "VERTICES of level 1 is missing");
}

}  // namespace
}  // namespace hapticlod
