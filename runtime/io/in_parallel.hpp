// Jobs of opening a file, spread over a few threads that are gone when this returns. Never in the loop.
#pragma once
#include <cstddef>
#include <functional>
#include <span>

namespace hapticlod {

struct Job {
    std::size_t bytes;          // roughly what it reads: long ones are begun first
    std::function<void()> run;  // must not touch what another job writes
};

// Returns when all have run. Few bytes are not worth a thread, and where no thread can be started the caller's does it
// all. What a job throws is thrown here, after all have ended.
void run_in_parallel(std::span<const Job> jobs);

}  // namespace hapticlod
