#include "station/toml_reader.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>

namespace hapticlod::station {
namespace {

const TomlNode kEmptyTable{};

std::string shortest(double value) {
    char digits[32];
    return {digits, std::to_chars(digits, digits + sizeof(digits), value).ptr};
}

bool in_range(double value, double least, double most) {
    return std::isfinite(value) && value >= least && value <= most;
}

std::string range(double least, double most) {
    if (std::isinf(most)) return "a finite number of at least " + shortest(least);
    return "from " + shortest(least) + " to " + shortest(most);
}

}  // namespace

std::string TomlReader::field(std::string_view key) const {
    return path_.empty() ? std::string(key) : path_ + "." + std::string(key);
}

void TomlReader::add(const TomlNode& at, std::string_view key, const std::string& message) {
    faults_->push_back({at.line, at.column, field(key) + ": " + message});
}

void TomlReader::fault(std::string_view key, const std::string& message) {
    const TomlNode* node = table_->find(key);
    add(node != nullptr ? *node : *table_, key, message);
}

const TomlNode* TomlReader::take(std::string_view key, TomlNode::Kind kind, const char* name, bool may_miss) {
    asked_.emplace(key);
    const TomlNode* node = table_->find(key);
    if (node == nullptr) {
        if (!may_miss) fault(key, "missing");
        return nullptr;
    }
    const bool whole_as_number = kind == TomlNode::Kind::number && node->kind == TomlNode::Kind::integer;
    if (node->kind != kind && !whole_as_number) {
        fault(key, std::string("should be ") + name);
        return nullptr;
    }
    return node;
}

std::string TomlReader::text(std::string_view key, std::optional<std::string> absent) {
    const TomlNode* node = take(key, TomlNode::Kind::string, "a string", absent.has_value());
    return node != nullptr ? node->text : absent.value_or("");
}

double TomlReader::number(std::string_view key, double least, double most, std::optional<double> absent) {
    const TomlNode* node = take(key, TomlNode::Kind::number, "a number", absent.has_value());
    if (node == nullptr) return absent.value_or(0.0);
    if (!in_range(node->number, least, most)) fault(key, "should be " + range(least, most));
    return node->number;
}

std::int64_t TomlReader::integer(std::string_view key, std::int64_t least, std::int64_t most,
                                 std::optional<std::int64_t> absent) {
    const TomlNode* node = take(key, TomlNode::Kind::integer, "a whole number", absent.has_value());
    if (node == nullptr) return absent.value_or(0);
    if (node->integer < least || node->integer > most) {
        fault(key, "should be from " + std::to_string(least) + " to " + std::to_string(most));
        return least;
    }
    return node->integer;
}

bool TomlReader::boolean(std::string_view key, bool absent) {
    const TomlNode* node = take(key, TomlNode::Kind::boolean, "true or false", true);
    return node != nullptr ? node->boolean : absent;
}

std::vector<double> TomlReader::numbers(std::string_view key, std::size_t count, double least, double most,
                                        std::optional<std::vector<double>> absent) {
    const TomlNode* node = take(key, TomlNode::Kind::array, "an array", absent.has_value());
    if (node == nullptr) return absent.value_or(std::vector<double>(count, 0.0));
    std::vector<double> values;
    for (const TomlNode& item : node->items) {
        const bool number = item.kind == TomlNode::Kind::number || item.kind == TomlNode::Kind::integer;
        if (!number || !in_range(item.number, least, most)) {
            add(item, key, "should hold numbers, each " + range(least, most));
            return std::vector<double>(count, least);
        }
        values.push_back(item.number);
    }
    if (values.size() != count) fault(key, "should hold " + std::to_string(count) + " numbers");
    values.resize(count, 0.0);
    return values;
}

std::vector<double> TomlReader::matrix(std::string_view key, std::size_t rows, std::size_t columns,
                                       std::optional<std::vector<double>> absent) {
    const TomlNode* node = take(key, TomlNode::Kind::array, "an array of arrays", absent.has_value());
    if (node == nullptr) return absent.value_or(std::vector<double>(rows * columns, 0.0));
    std::vector<double> values;
    bool good = node->items.size() == rows;
    for (const TomlNode& row : node->items) {
        good = good && row.kind == TomlNode::Kind::array && row.items.size() == columns;
        for (const TomlNode& item : row.items) {
            good = good && (item.kind == TomlNode::Kind::number || item.kind == TomlNode::Kind::integer) &&
                   std::isfinite(item.number);
            values.push_back(item.number);
        }
    }
    if (!good) {
        fault(key, "should be " + std::to_string(rows) + " rows of " + std::to_string(columns) + " finite numbers");
        return absent.value_or(std::vector<double>(rows * columns, 0.0));
    }
    return values;
}

TomlReader TomlReader::table(std::string_view key, bool required) {
    const TomlNode* node = take(key, TomlNode::Kind::table, "a table", !required);
    return {node != nullptr ? *node : kEmptyTable, field(key), *faults_};
}

std::vector<TomlReader> TomlReader::tables(std::string_view key) {
    std::vector<TomlReader> readers;
    const TomlNode* node = take(key, TomlNode::Kind::array, "an array of tables", true);
    if (node == nullptr) return readers;
    for (std::size_t i = 0; i < node->items.size(); ++i) {
        if (node->items[i].kind != TomlNode::Kind::table) {
            add(node->items[i], key, "should hold tables");
            continue;
        }
        readers.emplace_back(node->items[i], field(key) + "." + std::to_string(i), *faults_);
    }
    return readers;
}

void TomlReader::finish() {
    for (std::size_t i = 0; i < table_->keys.size(); ++i) {
        const std::string& name = table_->keys[i];
        if (!asked_.contains(name)) add(table_->items[i], name, "unknown key");
    }
}

Fault joined(std::vector<TomlFault> faults, const std::string& file) {
    std::stable_sort(faults.begin(), faults.end(),
                     [](const TomlFault& a, const TomlFault& b) { return a.line < b.line; });
    const auto place = [&file](const TomlFault& fault) {
        return file + ":" + std::to_string(fault.line) + ":" + std::to_string(fault.column);
    };
    std::string what = faults.front().what;
    for (std::size_t i = 1; i < faults.size(); ++i) what += " | " + place(faults[i]) + ": " + faults[i].what;
    return {place(faults.front()), what,
            faults.size() == 1 ? "correct it" : "correct these " + std::to_string(faults.size()) + " entries"};
}

}  // namespace hapticlod::station
