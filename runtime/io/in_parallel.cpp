#include "io/in_parallel.hpp"

#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <numeric>
#include <system_error>
#include <thread>
#include <vector>

namespace hapticlod {
namespace {

constexpr std::size_t kMostThreads = 8;
constexpr std::size_t kBytesWorthAThread = 4u << 20;  // a few milliseconds

}  // namespace

void run_in_parallel(std::span<const Job> jobs) {
    std::vector<std::size_t> order(jobs.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return jobs[a].bytes > jobs[b].bytes; });
    std::atomic<std::size_t> next{0};
    std::mutex guard;
    std::exception_ptr thrown;
    const auto work = [&] {
        for (std::size_t i = next++; i < order.size(); i = next++) {
            try {
                jobs[order[i]].run();
            } catch (...) {
                const std::lock_guard lock(guard);
                thrown = std::current_exception();
            }
        }
    };
    std::size_t bytes = 0;
    for (const Job& job : jobs) bytes += job.bytes;
    const std::size_t threads = std::min(
        {std::size_t{std::thread::hardware_concurrency()}, jobs.size(), kMostThreads, 1 + bytes / kBytesWorthAThread});
    std::vector<std::jthread> others;
    others.reserve(threads);
    try {
        for (std::size_t i = 1; i < threads; ++i) others.emplace_back(work);
    } catch (const std::system_error&) {  // as many as there are, then
    }
    work();
    others.clear();  // joins
    if (thrown) std::rethrow_exception(thrown);
}

}  // namespace hapticlod
