// What tests ask of a made bundle: is it refused, and why; does it render its golden motion again?
#pragma once
#include <gtest/gtest.h>

#include <cstring>
#include <string>

#include "bundle_maker.hpp"
#include "io/bundle.hpp"

namespace hapticlod::test {

// The reason of a refusal, empty when the bundle was taken.
inline std::string refusal(const std::string& file) {
    const TemporaryFile temporary(file);
    const auto bundle = Bundle::open(temporary.path());
    return bundle ? "" : bundle.fault().line();
}

inline void expect_refused(const std::string& file, const std::string& because) {
    const std::string reason = refusal(file);
    EXPECT_NE(reason.find(because), std::string::npos) << "said: '" << reason << "'";
}

// The golden record again from what was read, bit for bit.
inline void expect_golden(const Bundle& bundle) {
    Renderer renderer;
    ASSERT_EQ(renderer.load(bundle.config(), bundle.levels(), bundle.tool()), "");
    const auto records = render(renderer, bundle.golden_motion());
    for (std::size_t i = 0; i < records.size(); ++i) {
        ASSERT_EQ(std::memcmp(&records[i], &bundle.golden_record()[i], sizeof(TickRecord)), 0) << i;
    }
}

}  // namespace hapticlod::test
