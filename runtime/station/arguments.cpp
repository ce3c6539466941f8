#include "station/arguments.hpp"

#include <algorithm>
#include <charconv>
#include <cstdio>

namespace hapticlod::station {
namespace {

constexpr const char* kHelp = "run hapticlod-station --help";

std::string shortest(double value) {
    char digits[32];
    return {digits, std::to_chars(digits, digits + sizeof(digits), value).ptr};
}

}  // namespace

Result<Arguments> Arguments::parse(std::span<const std::string_view> words, const ArgumentRules& rules) {
    const auto has = [](const auto& list, std::string_view name) {
        return std::find(list.begin(), list.end(), name) != list.end();
    };
    Arguments arguments;
    for (std::size_t i = 0; i < words.size(); ++i) {
        const std::string_view word = words[i] == "-o" ? "--out" : words[i];
        if (!word.starts_with("--")) {
            if (arguments.positional_.size() == rules.positional.size()) {
                return Fault{std::string(word), "is one argument too many", kHelp};
            }
            arguments.positional_.emplace_back(word);
            continue;
        }
        const std::size_t equals = word.find('=');
        const std::string_view name = word.substr(0, equals);
        if (arguments.values_.contains(name)) return Fault{std::string(name), "is given twice", "give it once"};
        if (has(rules.flags, name) && equals == std::string_view::npos) {
            arguments.values_.emplace(name, "");
        } else if (!has(rules.options, name)) {
            return Fault{std::string(name), "is no option of this command", kHelp};
        } else if (equals != std::string_view::npos) {
            arguments.values_.emplace(name, word.substr(equals + 1));
        } else if (i + 1 < words.size()) {
            arguments.values_.emplace(name, words[++i]);
        } else {
            return Fault{std::string(name), "needs a value", kHelp};
        }
    }
    if (arguments.positional_.size() < rules.positional.size()) {
        const std::string_view missing = rules.positional.begin()[arguments.positional_.size()];
        return Fault{std::string(missing), "is missing", kHelp};
    }
    return arguments;
}

std::optional<std::string> Arguments::option(std::string_view name) const {
    const auto found = values_.find(name);
    if (found == values_.end()) return std::nullopt;
    return found->second;
}

Result<double> Arguments::number(std::string_view name, double absent, double least, double most) const {
    const std::optional<std::string> text = option(name);
    if (!text) return absent;
    double value = 0.0;
    const char* end = text->data() + text->size();
    const auto [stop, error] = std::from_chars(text->data(), end, value);
    if (error != std::errc() || stop != end || !(value >= least && value <= most)) {
        return Fault{std::string(name), "is '" + *text + "'",
                     "give a number from " + shortest(least) + " to " + shortest(most)};
    }
    return value;
}

}  // namespace hapticlod::station
