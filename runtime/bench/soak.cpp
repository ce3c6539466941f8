// Random motions against the invariants of docs/contact.md, for as long as one likes.
//
//   soak [TICKS] [--kind NAME] [--seed FIRST] [--run TICKS] [--thin N] [--go-on]
//
// TICKS: 1e8. Runs of --run ticks (20000), each with its own seed, which names mesh, tool, configuration and motion;
// every 16th is run twice and must give the same bits. --thin: every N-th tick is held against all triangles. --go-on:
// faults are listed, not final. A line every minute; Ctrl-C ends with the summary. Exit status 1 where anything was
// wrong.
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <iostream>

#include "tests/soak_run.hpp"

namespace {

using namespace hapticlod::test;
using Clock = std::chrono::steady_clock;

volatile std::sig_atomic_t stop = 0;
extern "C" void on_signal(int) { stop = 1; }

void summarise(const SoakTally& t, double seconds) {
    const double ticks = static_cast<double>(std::max<std::uint64_t>(t.ticks, 1));
    std::cout << t.ticks << " ticks, " << t.contacts << " in contact, " << t.switches << " switches (" << t.mapped
              << " mapped, " << t.lost << " lost), " << t.started_inside << " starts inside, " << t.faults
              << " bad poses and times, " << t.held << " turns held, " << t.not_converged << " not converged\n"
              << t.distances << " clearances (least " << 1e3 * t.deepest_mm << " um), " << t.sides << " sides, "
              << t.paths << " paths; largest force step " << t.largest_step_n << " N; " << seconds << " s, "
              << 1e6 * seconds / ticks << " us per tick" << std::endl;
}

double number(const std::string& text) {
    char* end = nullptr;
    const double value = std::strtod(text.c_str(), &end);
    if (text.empty() || *end != 0 || !(value >= 1.0) || !(value <= 1e15)) {
        std::cerr << "soak: '" << text << "' is not a number from 1 to 1e15\n";
        std::exit(2);
    }
    return value;
}

SoakKind kind_of(const std::string& name) {
    for (const SoakKind kind : kSoakKinds)
        if (name == name_of(kind)) return kind;
    std::cerr << "soak: '" << name << "' is no kind of run\n";
    std::exit(2);
}

}  // namespace

int main(int argc, char** argv) {
    std::uint64_t wanted = 100'000'000, seed = 0, run = 20'000, thin = 512;
    bool go_on = false;
    std::vector<SoakKind> kinds(std::begin(kSoakKinds), std::end(kSoakKinds));
    for (int i = 1; i < argc; ++i) {
        const std::string arg = argv[i];
        const auto value = [&] { return static_cast<std::uint64_t>(number(i + 1 < argc ? argv[++i] : "")); };
        if (arg == "--seed")
            seed = i + 1 < argc ? std::strtoull(argv[++i], nullptr, 10) : 0;
        else if (arg == "--kind")
            kinds = {kind_of(i + 1 < argc ? argv[++i] : "")};
        else if (arg == "--run")
            run = value();
        else if (arg == "--thin")
            thin = value();
        else if (arg == "--go-on")
            go_on = true;
        else
            wanted = static_cast<std::uint64_t>(number(arg));
    }
    const SoakBodies bodies;
    for (const SoakBody* body : {&bodies.body, &bodies.plate})
        if (!body->fault.empty()) {
            std::cerr << "soak: " << body->fault << '\n';
            return 2;
        }
    std::signal(SIGINT, on_signal);
    std::signal(SIGTERM, on_signal);
    SoakTally total;
    const auto start = Clock::now();
    auto said = start;
    std::uint64_t faults = 0, runs = 0;
    const auto seconds = [&] { return std::chrono::duration<double>(Clock::now() - start).count(); };
    for (; total.ticks < wanted && stop == 0; ++runs) {
        const SoakKind kind = kinds[runs % kinds.size()];
        if (runs > 0 && runs % kinds.size() == 0) ++seed;
        const std::uint64_t ticks = std::min(run, wanted - total.ticks);
        const SoakOutcome outcome = soak_run(bodies, kind, seed, ticks, thin);
        total.add(outcome.tally);
        std::string fault = outcome.fault;
        if (fault.empty() && runs % 16 == 0 && stop == 0 &&
            soak_run(bodies, kind, seed, ticks, thin).digest != outcome.digest)
            fault = std::string(name_of(kind)) + " " + std::to_string(seed) + ": a second run gave other bits";
        if (!fault.empty()) {
            ++faults;
            std::cout << "WRONG " << fault << std::endl;
            if (!go_on) break;
        }
        if (Clock::now() - said >= std::chrono::minutes(1)) {
            said = Clock::now();
            std::cout << total.ticks << " of " << wanted << " ticks, " << faults << " wrong, " << seconds() << " s"
                      << std::endl;
        }
    }
    if (stop != 0) std::cout << "stopped early; next seed " << seed << '\n';
    summarise(total, seconds());
    std::cout << (faults == 0 ? "nothing wrong" : std::to_string(faults) + " runs wrong") << std::endl;
    return faults == 0 ? 0 : 1;
}
