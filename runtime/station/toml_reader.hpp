// Strict reading of one TOML table: every value has a type and a range, every key must have been asked for, and every
// fault is kept with its place, so that a user mends a file once and not once per fault.
#pragma once
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "station/toml_file.hpp"

namespace hapticlod::station {

struct TomlFault {
    unsigned line, column;
    std::string what;  // "field: message"
};

class TomlReader {
public:
    TomlReader(const TomlNode& table, std::string path, std::vector<TomlFault>& faults)
        : table_(&table), path_(std::move(path)), faults_(&faults) {}

    [[nodiscard]] bool has(std::string_view key) const { return table_->find(key) != nullptr; }
    // Where a value is missing or wrong, the fault is kept and `absent` (or 0, or "") is given.
    std::string text(std::string_view key, std::optional<std::string> absent = {});
    double number(std::string_view key, double least, double most, std::optional<double> absent = {});
    std::int64_t integer(std::string_view key, std::int64_t least, std::int64_t most,
                         std::optional<std::int64_t> absent = {});
    bool boolean(std::string_view key, bool absent);
    // Exactly `count` numbers.
    std::vector<double> numbers(std::string_view key, std::size_t count, double least, double most,
                                std::optional<std::vector<double>> absent = {});
    // rows x columns numbers, row by row.
    std::vector<double> matrix(std::string_view key, std::size_t rows, std::size_t columns,
                               std::optional<std::vector<double>> absent = {});
    // An absent table reads as an empty one; `required` makes it a fault.
    [[nodiscard]] TomlReader table(std::string_view key, bool required = true);
    // An array of tables; empty where there is none.
    [[nodiscard]] std::vector<TomlReader> tables(std::string_view key);
    [[nodiscard]] const std::vector<std::string>& keys() const { return table_->keys; }

    // A fault of a key's value (or of the whole table, where there is no such key).
    void fault(std::string_view key, const std::string& message);
    // Call at the end: keys that were never asked for are faults.
    void finish();

private:
    const TomlNode* take(std::string_view key, TomlNode::Kind kind, const char* name, bool may_miss);
    [[nodiscard]] std::string field(std::string_view key) const;
    void add(const TomlNode& at, std::string_view key, const std::string& message);

    const TomlNode* table_;
    std::string path_;
    std::vector<TomlFault>* faults_;
    std::set<std::string, std::less<>> asked_;
};

// All faults as one, in file order: "file:line:column: field: message | line:column: ...".
[[nodiscard]] Fault joined(std::vector<TomlFault> faults, const std::string& file);

}  // namespace hapticlod::station
