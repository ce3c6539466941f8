// A TOML file as a tree that knows where everything stands. The parser is toml++; no other file sees it.
#pragma once
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "io/result.hpp"

namespace hapticlod::station {

struct TomlNode {
    enum class Kind { table, array, string, integer, number, boolean, other };
    Kind kind = Kind::table;
    std::string text;          // string
    double number = 0.0;       // number, and integer
    std::int64_t integer = 0;  // integer
    bool boolean = false;
    std::vector<TomlNode> items;    // array, or the values of a table
    std::vector<std::string> keys;  // table: one per item
    unsigned line = 1, column = 1;  // of the key, or of the item

    [[nodiscard]] const TomlNode* find(std::string_view key) const;
};

// Syntax and encoding are checked; the fault carries file:line:column.
[[nodiscard]] Result<TomlNode> read_toml(const std::string& path);
[[nodiscard]] Result<TomlNode> parse_toml(std::string_view text, const std::string& name);

}  // namespace hapticlod::station
