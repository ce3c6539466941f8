// One fixed level, no LOD: the contact loop over recorded motions, timed. Pairs this library with others.
//
//   contact_replay MESH.stl MOTION.csv OUT.csv [MOTION.csv OUT.csv ...] [--radius R | --tool FILE] [--stiffness K]
//                  [--repeat N] [--cold MB] [--friction MUS MUD] [--cell-edges E] [--crack MM] [--hz RATE]
//
// MOTION: rows x_mm,y_mm,z_mm under a header, one per period. --tool: rows x_mm,y_mm,z_mm,radius_mm under a header.
// OUT: fx,fy,fz,px,py,pz,ns,contacts. A tick's time is its least over the repeats. --cold sweeps that many MB of other
// memory between ticks. Last line of standard output: JSON, times in ns, and what a tick counts (means).
#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <iostream>
#include <limits>
#include <sstream>

#include "bench/stl_mesh.hpp"
#include "core/renderer.hpp"

namespace {

using namespace hapticlod;
using Clock = std::chrono::steady_clock;

struct Options {
    std::string mesh, tool;
    std::vector<std::pair<std::string, std::string>> runs;
    double radius = 0.0, stiffness = 1.0, mu_static = 0.0, mu_dynamic = 0.0, cell_edges = 3.0, crack = -1.0,
           hz = 1000.0;
    int repeat = 5;
    std::size_t cold_mb = 0;
};

Options parse(int argc, char** argv) {
    Options o;
    std::vector<std::string> files;
    for (int i = 1; i < argc; ++i) {
        const std::string arg = argv[i];
        const auto next = [&]() -> std::string {
            if (i + 1 >= argc) throw std::runtime_error(arg + " needs a value");
            return argv[++i];
        };
        const auto number = [&] {
            const std::string text = next();
            char* end = nullptr;
            const double value = std::strtod(text.c_str(), &end);
            if (end == text.c_str() || *end != 0 || !(value >= 0.0) || !std::isfinite(value))
                throw std::runtime_error(arg + ": '" + text + "' is not a number >= 0");
            return value;
        };
        if (arg == "--radius")
            o.radius = number();
        else if (arg == "--tool")
            o.tool = next();
        else if (arg == "--stiffness")
            o.stiffness = number();
        else if (arg == "--repeat")
            o.repeat = std::max(1, static_cast<int>(number()));
        else if (arg == "--cold")
            o.cold_mb = static_cast<std::size_t>(number());
        else if (arg == "--friction")
            o.mu_static = number(), o.mu_dynamic = number();
        else if (arg == "--cell-edges")
            o.cell_edges = number();
        else if (arg == "--crack")
            o.crack = number();
        else if (arg == "--hz")
            o.hz = number();
        else if (arg.starts_with("--"))
            throw std::runtime_error("unknown option " + arg);
        else
            files.push_back(arg);
    }
    if (files.size() < 3 || files.size() % 2 == 0)
        throw std::runtime_error(
            "usage: contact_replay MESH.stl MOTION.csv OUT.csv [MOTION.csv OUT.csv ...] [options]");
    o.mesh = files[0];
    for (std::size_t i = 1; i < files.size(); i += 2) o.runs.emplace_back(files[i], files[i + 1]);
    return o;
}

std::vector<double> read_rows(const std::string& path, std::size_t columns) {
    std::ifstream in(path);
    if (!in) throw std::runtime_error(path + ": cannot be opened; check the path");
    std::vector<double> values;
    std::string line;
    std::getline(in, line);
    for (std::size_t n = 2; std::getline(in, line); ++n) {
        std::istringstream cells(line);
        std::string cell;
        std::size_t got = 0;
        while (std::getline(cells, cell, ',')) {
            char* end = nullptr;
            values.push_back(std::strtod(cell.c_str(), &end));
            if (end == cell.c_str() || ++got > columns) break;
        }
        if (got != columns)
            throw std::runtime_error(path + ":" + std::to_string(n) + ": expected " + std::to_string(columns) +
                                     " numbers");
    }
    if (values.empty()) throw std::runtime_error(path + ": no rows");
    return values;
}

double rss_mb() {
    std::ifstream in("/proc/self/statm");
    double pages = 0, resident = 0;
    in >> pages >> resident;
    return resident * 4096.0 / 1e6;
}

double since_ms(Clock::time_point start) {
    return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

// Nearest-rank percentile of sorted values.
double percentile(const std::vector<float>& sorted, double p) {
    const double rank = std::ceil(p * static_cast<double>(sorted.size()));
    return sorted[static_cast<std::size_t>(std::max(rank, 1.0)) - 1];
}

std::string run(Renderer& renderer, const Options& o, const std::string& motion, const std::string& out_path) {
    const std::vector<double> path = read_rows(motion, 3);
    const std::size_t n = path.size() / 3;
    std::vector<TickRecord> rows(n);
    std::vector<float> ns(n, std::numeric_limits<float>::max());
    std::vector<unsigned char> sweep(o.cold_mb << 20, 1);
    volatile unsigned sink = 0;
    for (int r = 0; r < o.repeat; ++r) {
        renderer.reset();
        for (std::size_t i = 0; i < n; ++i) {
            for (std::size_t k = 0; k < sweep.size(); k += 64) sink = sink + sweep[k]++;
            const Pose pose{{path[3 * i], path[3 * i + 1], path[3 * i + 2]}};
            const auto start = Clock::now();
            renderer.tick(pose, static_cast<double>(i) / o.hz, rows[i]);
            ns[i] = std::min(ns[i], std::chrono::duration<float, std::nano>(Clock::now() - start).count());
        }
    }
    std::ofstream out(out_path);
    if (!out) throw std::runtime_error(out_path + ": cannot be written; check the folder");
    out.precision(9);
    out << "fx,fy,fz,px,py,pz,ns,contacts\n";
    for (std::size_t i = 0; i < n; ++i) {
        const TickRecord& t = rows[i];
        for (const double f : t.force_n) out << f << ',';
        for (const double p : t.scp_mm) out << p << ',';
        out << ns[i] << ',' << int{t.constraints} << '\n';
    }
    std::vector<float> sorted = ns;
    std::sort(sorted.begin(), sorted.end());
    double mean = 0.0;
    for (const float v : sorted) mean += double{v} / static_cast<double>(n);
    std::ostringstream json;
    json << "{\"mean\": " << mean << ", \"p50\": " << percentile(sorted, 0.5)
         << ", \"p75\": " << percentile(sorted, 0.75) << ", \"p99\": " << percentile(sorted, 0.99)
         << ", \"p999\": " << percentile(sorted, 0.999) << ", \"max\": " << sorted.back() << ", \"per_tick\": {";
    const auto counted = [&](const char* name, std::uint32_t TickRecord::*counter, const char* after) {
        double sum = 0.0;
        for (const TickRecord& t : rows) sum += t.*counter;
        json << '"' << name << "\": " << sum / static_cast<double>(n) << after;
    };
    counted("cells", &TickRecord::cells, ", ");
    counted("triangles", &TickRecord::triangles, ", ");
    counted("tests", &TickRecord::tests, ", ");
    counted("balls", &TickRecord::balls, ", ");
    counted("iterations", &TickRecord::iterations, "}}");
    return json.str();
}

int replay(int argc, char** argv) {
    const Options o = parse(argc, argv);
    auto start = Clock::now();
    bench::Mesh mesh = bench::read_stl(o.mesh);
    const double load_ms = since_ms(start);
    const double before_mb = rss_mb();

    // Vertices relative to the middle of the model, as in a bundle.
    double lo[3] = {1e300, 1e300, 1e300}, hi[3] = {-1e300, -1e300, -1e300}, edge = 0.0;
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
        lo[i % 3] = std::min(lo[i % 3], double{mesh.vertices[i]});
        hi[i % 3] = std::max(hi[i % 3], double{mesh.vertices[i]});
    }
    ConfigData config{};
    config.version = kConfigVersion;
    config.level_count = 1;
    config.mapping = static_cast<std::uint32_t>(Mapping::two_sided);
    double diagonal = 0.0;
    for (int k = 0; k < 3; ++k)
        config.origin_mm[k] = 0.5 * (lo[k] + hi[k]), diagonal = std::hypot(diagonal, hi[k] - lo[k]);
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i)
        mesh.vertices[i] = static_cast<float>(double{mesh.vertices[i]} - config.origin_mm[i % 3]);
    const std::size_t sampled = std::min<std::size_t>(mesh.faces.size() / 3, 100000);
    for (std::size_t i = 0; i < sampled; ++i) {
        const std::size_t f = i * (mesh.faces.size() / 3 / sampled);
        const float* a = &mesh.vertices[3 * std::size_t{mesh.faces[3 * f]}];
        const float* b = &mesh.vertices[3 * std::size_t{mesh.faces[3 * f + 1]}];
        edge +=
            std::hypot(double{a[0]} - b[0], double{a[1]} - b[1], double{a[2]} - b[2]) / static_cast<double>(sampled);
    }
    config.loop_hz = o.hz;
    config.stiffness_n_mm = o.stiffness;
    config.friction_static = o.mu_static;
    config.friction_dynamic = o.mu_dynamic;
    config.crack_mm = o.crack >= 0.0 ? o.crack : 4e-4 * diagonal;
    config.engage_s = 0.05;
    config.filter_hz = 30.0;
    config.balls[0] = kMaxBalls;

    start = Clock::now();
    LevelStorage level;
    if (const std::string fault = level.build(mesh.vertices, mesh.faces, o.cell_edges * edge); !fault.empty())
        throw std::runtime_error(o.mesh + ": " + fault);
    const double build_ms = since_ms(start);
    const std::size_t triangles = mesh.faces.size() / 3;
    mesh = {};

    std::vector<BallData> tool{{{0, 0, 0}, o.radius}};
    if (!o.tool.empty()) {
        const std::vector<double> rows = read_rows(o.tool, 4);
        tool.clear();
        for (std::size_t i = 0; i < rows.size(); i += 4)
            tool.push_back({{rows[i], rows[i + 1], rows[i + 2]}, rows[i + 3]});
    }
    Renderer renderer;
    const LevelView view = level.view();
    if (const std::string fault = renderer.load(config, {&view, 1}, tool); !fault.empty())
        throw std::runtime_error(fault);

    std::string runs;
    for (const auto& [motion, out] : o.runs) runs += (runs.empty() ? "" : ", ") + run(renderer, o, motion, out);
    std::cout << "{\"tris\": " << triangles << ", \"load_ms\": " << load_ms << ", \"build_ms\": " << build_ms
              << ", \"rss_mb\": " << rss_mb() << ", \"loaded_mb\": " << before_mb << ", \"level_bytes_per_triangle\": "
              << static_cast<double>(view.bytes()) / static_cast<double>(triangles) << ", \"runs\": [" << runs
              << "]}\n";
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    try {
        return replay(argc, argv);
    } catch (const std::exception& e) {
        std::cerr << "contact_replay: " << e.what() << '\n';
        return 2;
    }
}
