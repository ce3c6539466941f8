// Materials in a bundle: used in place, kept where a level is rebuilt, checked, and never skipped in silence.
#include <gtest/gtest.h>

#include <cmath>

#include "bundle_maker.hpp"
#include "bundle_verdicts.hpp"
#include "io/bundle.hpp"

namespace hapticlod {
namespace {

using test::expect_golden;
using test::expect_refused;
using test::MadeBundle;
using test::plate_bundle;
using test::TemporaryFile;

TEST(BundleMaterials, AreUsedInPlaceAndFelt) {
    const MadeBundle made = plate_bundle(true), plain = plate_bundle();
    const TemporaryFile file(made.sealed());
    auto opened = Bundle::open(file.path());
    ASSERT_TRUE(opened) << opened.fault().line();
    const Bundle bundle = std::move(opened).value();
    ASSERT_EQ(bundle.levels()[0].materials.size(), 49u);
    ASSERT_EQ(bundle.levels()[1].materials.size(), 16u);
    EXPECT_FALSE(bundle.rebuilt(0));
    expect_golden(bundle);
    const auto bytes = [](MadeBundle b) { return b.at(SectionType::golden_record).bytes; };
    EXPECT_NE(bytes(made), bytes(plain));
}

TEST(BundleMaterials, OutliveARebuild) {
    MadeBundle made = plate_bundle(true);
    made.at(SectionType::cells, 0).version = 9;
    std::erase_if(made.sections, [](const auto& s) { return s.type == SectionType::hash && s.level == 1; });
    const TemporaryFile file(made.sealed());
    const auto opened = Bundle::open(file.path());
    ASSERT_TRUE(opened) << opened.fault().line();
    EXPECT_TRUE(opened.value().rebuilt(0) && opened.value().rebuilt(1));
    expect_golden(opened.value());
}

TEST(BundleMaterials, OneLevelMayHaveNone) {
    MadeBundle made = plate_bundle(true);
    std::erase_if(made.sections, [](const auto& s) { return s.type == SectionType::materials && s.level == 1; });
    const TemporaryFile file(made.sealed());
    const auto opened = Bundle::open(file.path());
    ASSERT_TRUE(opened) << opened.fault().line();
    EXPECT_TRUE(opened.value().levels()[1].materials.empty());
}

TEST(BundleMaterials, ContentIsChecked) {
    const auto with = [](Material m) {
        MadeBundle made = plate_bundle(true);
        made.as<Material>(SectionType::materials, 1)[5] = m;
        return made;
    };
    const float nan = std::nanf("");
    for (const float k : {nan, 0.0f, -0.5f, 2e6f, INFINITY})
        expect_refused(with({k, 0.2f, 0.1f}).sealed(), "stiffness");
    for (const float mu : {nan, -0.1f, 11.0f, INFINITY, kAsStation})
        expect_refused(with({1, mu, 0.1f}).sealed(), "static");
    for (const float mu : {nan, -0.1f, 0.3f, kAsStation}) expect_refused(with({1, 0.2f, mu}).sealed(), "dynamic");
    MadeBundle made = plate_bundle(true);
    made.at(SectionType::materials, 1).bytes.resize(15 * sizeof(Material));
    expect_refused(made.sealed(), "level 1: materials and vertices differ in number");
    made.at(SectionType::materials, 1).bytes.clear();
    expect_refused(made.sealed(), "level 1: materials and vertices differ in number");
    made.at(SectionType::materials, 1).bytes.assign(16 * sizeof(Material) - 1, '\0');
    expect_refused(made.sealed(), "no multiple of 12");
    made = plate_bundle(true);
    made.at(SectionType::materials, 1).level = 2;
    expect_refused(made.sealed(), "belongs to no level");
    // A rebuilt level is checked too.
    made = plate_bundle(true);
    made.at(SectionType::cells, 1).version = 9;
    made.as<Material>(SectionType::materials, 1)[5].stiffness_n_mm = nan;
    expect_refused(made.sealed(), "stiffness");
}

TEST(BundleMaterials, AreNeverSkipped) {
    MadeBundle made = plate_bundle(true);
    made.at(SectionType::materials, 0).version = 2;
    expect_refused(made.sealed(), "MATERIALS of level 0: is needed and has version 2");
}

TEST(BundleMaterials, EveryFlippedByteIsRefusedOrHarmless) {
    const MadeBundle right = plate_bundle(true);
    std::size_t taken = 0, refused = 0;
    for (std::size_t s = 0; s < right.sections.size(); ++s) {
        if (right.sections[s].type != SectionType::materials) continue;
        for (std::size_t place = 0; place < right.sections[s].bytes.size(); ++place) {
            MadeBundle wrong = right;
            char& byte = wrong.sections[s].bytes[place];
            byte = static_cast<char>(byte ^ 0x41);
            const TemporaryFile file(wrong.sealed());
            const auto opened = Bundle::open(file.path());
            ++(opened ? taken : refused);
            if (!opened) continue;
            Renderer renderer;
            ASSERT_EQ(renderer.load(opened.value().config(), opened.value().levels(), opened.value().tool()), "");
            for (const TickRecord& r : test::render(renderer, opened.value().golden_motion())) {
                const double force = std::hypot(r.force_n[0], r.force_n[1], r.force_n[2]);
                ASSERT_TRUE(force <= opened.value().config().max_force_n * (1.0 + 1e-12)) << force;
            }
        }
    }
    EXPECT_GT(refused, 100u);
    EXPECT_GT(taken, 100u);  // another coefficient of friction is a material like any other
    // Unsealed, the digest tells.
    std::size_t at = 0;
    std::string file = right.sealed([&at](const SectionEntry& e) {
        if (e.type == static_cast<std::uint32_t>(SectionType::materials)) at = e.offset;
    });
    file[at + 5] ^= 1;
    const TemporaryFile spoiled(file);
    EXPECT_FALSE(Bundle::open(spoiled.path()));
}

}  // namespace
}  // namespace hapticlod
