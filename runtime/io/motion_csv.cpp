#include "io/motion_csv.hpp"

#include <array>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <optional>

#include "io/mapped_file.hpp"

namespace hapticlod {
namespace {

constexpr std::size_t kFields = 8;
constexpr double kLongestMotionS = 86400.0;  // resampling takes memory by the second
constexpr std::array<std::string_view, kFields> kNames = {"t_s", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"};
constexpr const char* kHeaderRemedy = "the first line must name the columns t_s,x_mm,y_mm,z_mm (and qw,qx,qy,qz)";

std::string_view trimmed(std::string_view text) {
    const std::size_t first = text.find_first_not_of(" \t\r\"");
    if (first == std::string_view::npos) return {};
    return text.substr(first, text.find_last_not_of(" \t\r\"") - first + 1);
}

std::vector<std::string_view> split(std::string_view line, char separator) {
    std::vector<std::string_view> parts;
    for (std::size_t start = 0;;) {
        const std::size_t stop = line.find(separator, start);
        parts.push_back(trimmed(line.substr(start, stop - start)));
        if (stop == std::string_view::npos) return parts;
        start = stop + 1;
    }
}

bool parse_number(std::string_view text, double& value) {
    if (!text.empty() && text.front() == '+') text.remove_prefix(1);
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    return error == std::errc() && end == text.data() + text.size();
}

// Short and printable, whatever the file holds.
std::string quoted(std::string_view text) {
    std::string shown = "'";
    for (const char letter : text.substr(0, 24)) {
        shown += static_cast<unsigned char>(letter) < 0x20 || letter == 0x7f ? '?' : letter;
    }
    return shown + "'";
}

struct Columns {
    char separator = ',';
    std::size_t count = 0;
    std::array<std::size_t, kFields> place{};
    std::optional<std::size_t> segment;  // where the file says which of several motions a row belongs to
    bool oriented = false;
};

Result<Columns> parse_header(std::string_view line, const std::string& where) {
    Columns columns;
    if (line.find('\t') != std::string_view::npos) columns.separator = '\t';
    const std::vector<std::string_view> names = split(line, columns.separator);
    columns.count = names.size();
    std::array<bool, kFields> found{};
    for (std::size_t place = 0; place < names.size(); ++place) {
        if (names[place] == "seg") columns.segment = place;
        for (std::size_t field = 0; field < kFields; ++field) {
            if (names[place] != kNames[field]) continue;
            if (found[field]) return Fault{where, "column " + quoted(names[place]) + " appears twice", kHeaderRemedy};
            found[field] = true;
            columns.place[field] = place;
        }
    }
    double ignored = 0.0;
    if (!names.empty() && parse_number(names[0], ignored)) return Fault{where, "has no header", kHeaderRemedy};
    columns.oriented = found[4] || found[5] || found[6] || found[7];
    for (std::size_t field = 0; field < (columns.oriented ? kFields : 4); ++field) {
        if (!found[field]) return Fault{where, "has no column " + quoted(kNames[field]), kHeaderRemedy};
    }
    return columns;
}

struct ParsedRow {
    MotionRow row;
    std::string_view segment;
};

Result<ParsedRow> parse_row(std::string_view line, const Columns& columns, const std::string& where) {
    const std::vector<std::string_view> parts = split(line, columns.separator);
    if (parts.size() != columns.count) {
        return Fault{where,
                     "has " + std::to_string(parts.size()) + " fields, the header " + std::to_string(columns.count),
                     "correct or remove the line"};
    }
    std::array<double, kFields> values = {0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0};
    for (std::size_t field = 0; field < (columns.oriented ? kFields : 4); ++field) {
        const std::string_view text = parts[columns.place[field]];
        if (!parse_number(text, values[field])) {
            return Fault{where, std::string(kNames[field]) + " is not a number (" + quoted(text) + ")",
                         "correct or remove the line"};
        }
        if (!std::isfinite(values[field])) {
            return Fault{where, std::string(kNames[field]) + " is not finite (" + quoted(text) + ")",
                         "correct or remove the line"};
        }
    }
    return ParsedRow{{values[0], {values[1], values[2], values[3]}, {values[4], values[5], values[6], values[7]}},
                     columns.segment ? parts[*columns.segment] : std::string_view{}};
}

}  // namespace

Result<std::vector<MotionRow>> parse_motion_csv(std::string_view text, const std::string& name) {
    std::vector<MotionRow> rows;
    Columns columns;
    std::string_view segment;
    if (text.starts_with("\x89MCAP")) {
        return Fault{name, "is a recording (MCAP), not a motion CSV",
                     "convert it: hapticlod recording " + name + " --motion --out motion.csv"};
    }
    if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);  // byte-order mark
    for (std::size_t number = 1; !text.empty(); ++number) {
        const std::size_t stop = text.find('\n');
        const std::string_view line = text.substr(0, stop);
        text = stop == std::string_view::npos ? std::string_view{} : text.substr(stop + 1);
        const std::string_view content = trimmed(line);
        if (content.empty() || content.front() == '#') continue;
        const std::string where = name + ":" + std::to_string(number);
        if (columns.count == 0) {
            const Result<Columns> header = parse_header(line, where);
            if (!header) return header.fault();
            columns = header.value();
            continue;
        }
        const Result<ParsedRow> parsed = parse_row(line, columns, where);
        if (!parsed) return parsed.fault();
        const auto& [row, row_segment] = parsed.value();
        if (rows.empty()) segment = row_segment;
        if (row_segment != segment) {
            return Fault{where, "a second segment begins", "keep one value of seg per file"};
        }
        if (!rows.empty() && row.time_s <= rows.back().time_s) {
            return Fault{where, "t_s does not increase",
                         "sort the rows by time, or split the file where time restarts"};
        }
        rows.push_back(row);
    }
    if (columns.count == 0) return Fault{name, "has no header", kHeaderRemedy};
    if (std::string reason = check_motion(rows); !reason.empty()) return Fault{name, reason, "record the motion again"};
    if (!(rows.back().time_s - rows.front().time_s <= kLongestMotionS)) {
        return Fault{name, "is longer than a day", "give t_s in seconds, or a part of the motion"};
    }
    return rows;
}

Result<std::vector<MotionRow>> read_motion_csv(const std::string& path) {
    const Result<MappedFile> file = MappedFile::open(path);
    if (!file) return file.fault();
    const auto bytes = file.value().bytes();
    return parse_motion_csv({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path);
}

}  // namespace hapticlod
