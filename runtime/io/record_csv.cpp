#include "io/record_csv.hpp"

#include <charconv>

namespace hapticlod {
namespace {

constexpr const char* kHeader =
    "time_s,hip_x_mm,hip_y_mm,hip_z_mm,scp_x_mm,scp_y_mm,scp_z_mm,force_x_n,force_y_n,force_z_n,"
    "torque_x_n_mm,torque_y_n_mm,torque_z_n_mm,speed_mm_s,cost_ns,level,contact,mapping,constraints,errors,"
    "cells,triangles,tests,iterations,balls,mapping_cells\n";

template <class T>
void add(std::string& text, T value, char after = ',') {
    char digits[32];
    text.append(digits, std::to_chars(digits, digits + sizeof(digits), value).ptr);
    text += after;
}

}  // namespace

std::string record_csv(std::span<const TickRecord> rows) {
    std::string text = kHeader;
    text.reserve(text.size() + rows.size() * 320);
    for (const TickRecord& row : rows) {
        add(text, row.time_s);
        for (const double value : row.hip_mm) add(text, value);
        for (const double value : row.scp_mm) add(text, value);
        for (const double value : row.force_n) add(text, value);
        for (const double value : row.torque_n_mm) add(text, value);
        add(text, row.speed_mm_s);
        add(text, row.cost_ns);
        add(text, unsigned{row.level});
        add(text, unsigned{row.contact});
        add(text, unsigned{row.mapping});
        add(text, unsigned{row.constraints});
        add(text, row.errors);
        add(text, row.cells);
        add(text, row.triangles);
        add(text, row.tests);
        add(text, row.iterations);
        add(text, row.balls);
        add(text, row.mapping_cells, '\n');
    }
    return text;
}

}  // namespace hapticlod
