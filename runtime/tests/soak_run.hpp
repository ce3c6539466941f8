// One run of the soak test: a case, a hand, so many ticks, judged; and a digest of its records, bit by bit.
#pragma once
#include "tests/soak_check.hpp"

namespace hapticlod::test {

struct SoakOutcome {
    SoakTally tally;
    std::uint64_t digest = 0xcbf29ce484222325ull;
    std::string fault;  // empty: none; otherwise what, in which case and tick
};

// FNV-1a over eight bytes at a time.
inline void digest_row(std::uint64_t& digest, const TickRecord& row) {
    std::uint64_t words[sizeof(TickRecord) / 8];
    std::memcpy(words, &row, sizeof words);
    for (const std::uint64_t w : words) digest = (digest ^ w) * 0x100000001b3ull, digest ^= digest >> 29;
}

inline SoakOutcome soak_run(const SoakBodies& bodies, SoakKind kind, std::uint64_t seed, std::uint64_t ticks,
                            std::uint64_t thinning) {
    const SoakCase c = soak_case(bodies, kind, seed);
    std::vector<LevelView> views;
    for (const LevelStorage& level : c.body->levels) views.push_back(level.view());
    SoakOutcome out;
    Renderer renderer;
    if (out.fault = renderer.load(c.config, views, c.tool); !out.fault.empty()) return out;
    SoakHand hand(c, seed);
    SoakCheck check(c, thinning);
    TickRecord row;
    for (std::uint64_t t = 0; t < ticks; ++t) {
        const SoakStep step = hand.next();
        renderer.tick(step.pose, step.time_s, row);
        digest_row(out.digest, row);
        if (const std::string fault = check.judge(step, row); !fault.empty()) {
            out.fault = std::string(name_of(kind)) + " " + std::to_string(seed) + ", tick " + std::to_string(t) +
                        ", level " + std::to_string(row.level) + ", errors " + std::to_string(row.errors) + " (" +
                        c.name + "): " + fault;
            break;
        }
    }
    out.tally = check.tally();
    return out;
}

}  // namespace hapticlod::test
