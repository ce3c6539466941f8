// What on this machine would disturb a loop, or keep it from starting, each with what to do about it.
#pragma once
#include <string>
#include <vector>

namespace hapticlod::station {

enum class Health { good, weak, bad };  // weak: the loop runs, worse than it could; bad: it will not do its work

struct Finding {
    std::string what;  // "real-time priority"
    Health health;
    std::string found;   // "at most 0"
    std::string remedy;  // empty where good
};

// `root` stands before every path that is read ("" on a real machine): tests bring their own.
[[nodiscard]] std::vector<Finding> diagnose(const std::string& root);

}  // namespace hapticlod::station
