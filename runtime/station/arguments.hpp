// Command-line words of one command: positional ones, `--name value` (or `--name=value`) and flags. -o is --out.
#pragma once
#include <initializer_list>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "io/result.hpp"

namespace hapticlod::station {

struct ArgumentRules {
    std::initializer_list<std::string_view> positional;  // names for messages; all are required
    std::initializer_list<std::string_view> options;     // take a value
    std::initializer_list<std::string_view> flags;
};

class Arguments {
public:
    [[nodiscard]] static Result<Arguments> parse(std::span<const std::string_view> words, const ArgumentRules& rules);

    [[nodiscard]] const std::string& positional(std::size_t index) const { return positional_[index]; }
    [[nodiscard]] bool flag(std::string_view name) const { return values_.contains(name); }
    [[nodiscard]] std::optional<std::string> option(std::string_view name) const;
    // A number within [least, most]; `absent` where the option was not given.
    [[nodiscard]] Result<double> number(std::string_view name, double absent, double least, double most) const;

private:
    std::vector<std::string> positional_;
    std::map<std::string, std::string, std::less<>> values_;
};

}  // namespace hapticlod::station
