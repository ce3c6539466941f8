#include "station/toml_file.hpp"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>

#include "station/toml_letters.hpp"

// Its assertions can fail on bad input (a control character after `[`), and with NDEBUG become assumptions for the
// optimiser. Its error paths say what they assert.
#undef NDEBUG
#define TOML_ASSERT(...) static_assert(true)
#define TOML_EXCEPTIONS 0
#define TOML_ENABLE_FORMATTERS 0
#include <toml++/toml.h>

namespace hapticlod::station {
namespace {

TomlNode converted(const toml::node& node, toml::source_position at) {
    TomlNode out;
    out.line = at.line;
    out.column = at.column;
    if (const toml::table* table = node.as_table()) {
        out.kind = TomlNode::Kind::table;
        for (auto&& [key, value] : *table) {
            // A key of a dotted or implicit table may have no place of its own.
            toml::source_position place = key.source().begin ? key.source().begin : value.source().begin;
            if (!place) place = at;
            out.keys.push_back(lowered_letters(key.str()));
            out.items.push_back(converted(value, place));
        }
    } else if (const toml::array* array = node.as_array()) {
        out.kind = TomlNode::Kind::array;
        for (const toml::node& item : *array) {
            out.items.push_back(converted(item, item.source().begin ? item.source().begin : at));
        }
    } else if (const auto* text = node.as_string()) {
        out.kind = TomlNode::Kind::string;
        out.text = lowered_letters(text->get());
    } else if (const auto* integer = node.as_integer()) {
        out.kind = TomlNode::Kind::integer;
        out.integer = integer->get();
        out.number = static_cast<double>(out.integer);
    } else if (const auto* number = node.as_floating_point()) {
        out.kind = TomlNode::Kind::number;
        out.number = number->get();
    } else if (const auto* boolean = node.as_boolean()) {
        out.kind = TomlNode::Kind::boolean;
        out.boolean = boolean->get();
    } else {
        out.kind = TomlNode::Kind::other;
    }
    return out;
}

}  // namespace

const TomlNode* TomlNode::find(std::string_view key) const {
    for (std::size_t i = 0; i < keys.size(); ++i) {
        if (keys[i] == key) return &items[i];
    }
    return nullptr;
}

Result<TomlNode> parse_toml(std::string_view text, const std::string& name) {
    const Result<std::string> raised = raised_letters(text, name);
    if (!raised) return raised.fault();
    const toml::parse_result parsed = toml::parse(std::string_view(raised.value()), name);
    if (!parsed) {
        const toml::parse_error& error = parsed.error();
        const toml::source_position at = error.source().begin;
        return Fault{name + ":" + std::to_string(at.line) + ":" + std::to_string(at.column),
                     "not TOML: " + lowered_letters(error.description()), "mend the syntax there"};
    }
    return converted(parsed.table(), {1, 1});
}

Result<TomlNode> read_toml(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::ostringstream text;
    if (!file || !(text << file.rdbuf())) {
        return Fault{path, std::string("cannot be read (") + std::strerror(errno) + ")",
                     "give the path of a readable TOML file"};
    }
    return parse_toml(text.view(), path);
}

}  // namespace hapticlod::station
