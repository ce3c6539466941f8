// From opening a bundle to its first tick: the file cold, in the page cache, and known from an opening before.
//
//   open_bundle BUNDLE [RUNS]
//
// One line of JSON per way, in milliseconds: the least and the median of RUNS (5), the parts of the median one, and the
// least processor time of all threads together, which a busy machine spoils least. "warm_one_processor" is warm again,
// on one. Cold drops the file from the page cache, which the kernel may refuse. The record of known files is a
// temporary one.
#include <fcntl.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

#include "core/renderer.hpp"
#include "io/bundle.hpp"

namespace {

using namespace hapticlod;
using Clock = std::chrono::steady_clock;

struct Times {
    double whole_ms, open_ms, renderer_ms, tick_ms, processor_ms;
    long faults;
    bool known;
};

double milliseconds(Clock::duration d) { return std::chrono::duration<double, std::milli>(d).count(); }

double processor_ms() {
    struct timespec now {};
    ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) * 1e3 + static_cast<double>(now.tv_nsec) * 1e-6;
}

long page_faults() {
    struct rusage use {};
    ::getrusage(RUSAGE_SELF, &use);
    return use.ru_minflt + use.ru_majflt;
}

void fail(const std::string& line) {
    std::fprintf(stderr, "%s\n", line.c_str());
    std::exit(2);
}

Times open_once(const std::string& path, CheckedFiles known) {
    const long faults = page_faults();
    const double processor = processor_ms();
    const auto start = Clock::now();
    const auto opened = Bundle::open(path, known);
    if (!opened) fail(opened.fault().line());
    const Bundle& bundle = opened.value();
    const auto open = Clock::now();
    Renderer renderer;
    if (const std::string reason = renderer.load(bundle.config(), bundle.levels(), bundle.tool()); !reason.empty()) {
        fail(path + ": " + reason);
    }
    const auto loaded = Clock::now();
    // On the surface, where a hand's first contact would be.
    const float* at = bundle.levels()[0].vertices.data();
    Pose pose;
    for (int k = 0; k < 3; ++k) pose.position_mm[k] = bundle.config().origin_mm[k] + double{at[k]};
    TickRecord record;
    renderer.tick(pose, 0.0, record);
    const auto ticked = Clock::now();
    return {milliseconds(ticked - start),  milliseconds(open - start), milliseconds(loaded - open),
            milliseconds(ticked - loaded), processor_ms() - processor, page_faults() - faults,
            bundle.checked_before()};
}

void drop_from_cache(const std::string& path) {
    const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    ::fsync(file);
    ::posix_fadvise(file, 0, 0, POSIX_FADV_DONTNEED);
    ::close(file);
}

void report(const char* way, std::vector<Times> runs) {
    std::sort(runs.begin(), runs.end(), [](const Times& a, const Times& b) { return a.whole_ms < b.whole_ms; });
    const Times& middle = runs[runs.size() / 2];
    double processor = middle.processor_ms;
    for (const Times& run : runs) processor = std::min(processor, run.processor_ms);
    std::printf(
        "{\"way\": \"%s\", \"least_ms\": %.1f, \"median_ms\": %.1f, \"open_ms\": %.1f, \"renderer_ms\": %.1f, "
        "\"first_tick_ms\": %.2f, \"least_processor_ms\": %.1f, \"page_faults\": %ld, \"known\": %s, \"runs\": %zu}\n",
        way, runs.front().whole_ms, middle.whole_ms, middle.open_ms, middle.renderer_ms, middle.tick_ms, processor,
        middle.faults, middle.known ? "true" : "false", runs.size());
}

}  // namespace

int main(int argc, char** argv) {
    if (argc < 2 || argc > 3) fail("usage: open_bundle BUNDLE [RUNS]");
    const std::string path = argv[1];
    const int runs = argc == 3 ? std::max(1, std::atoi(argv[2])) : 5;
    char record[] = "/tmp/hapticlod-open-XXXXXX";
    ::close(::mkstemp(record));
    const auto repeated = [&](auto&& once) {
        std::vector<Times> times;
        for (int i = 0; i < runs; ++i) times.push_back(once());
        return times;
    };
    report("cold", repeated([&] {
               drop_from_cache(path);
               return open_once(path, CheckedFiles({}));
           }));
    open_once(path, CheckedFiles({}));
    report("warm", repeated([&] { return open_once(path, CheckedFiles({})); }));
    std::this_thread::sleep_for(std::chrono::milliseconds(2100));  // a file that changed just now is not remembered
    open_once(path, CheckedFiles(record));
    report("known", repeated([&] { return open_once(path, CheckedFiles(record)); }));
    ::unlink(record);
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(std::max(0, ::sched_getcpu()), &one);
    if (::sched_setaffinity(0, sizeof(one), &one) == 0) {
        report("warm_one_processor", repeated([&] { return open_once(path, CheckedFiles({})); }));
    }
    return 0;
}
