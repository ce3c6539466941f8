// hapticlod._runtime: the core for Python. Shapes and dtypes are checked here, once.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <limits>
#include <memory>
#include <stdexcept>
#include <vector>

#include "core/kernels.hpp"
#include "core/occupancy.hpp"
#include "core/renderer.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using hapticlod::LevelStorage;
using hapticlod::LevelView;
using FloatRows = nb::ndarray<const float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using IndexRows = nb::ndarray<const std::uint32_t, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Times = nb::ndarray<const double, nb::shape<-1>, nb::c_contig, nb::device::cpu>;
using Positions = nb::ndarray<const double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Quaternions = nb::ndarray<const double, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;
using Floors = nb::ndarray<const std::uint32_t, nb::shape<-1>, nb::c_contig, nb::device::cpu>;
using Balls = nb::ndarray<const double, nb::shape<-1, 4>, nb::c_contig, nb::device::cpu>;

class Level {
public:
    Level(const FloatRows& vertices, const IndexRows& faces, double cell_mm,
          const std::optional<FloatRows>& materials) {
        std::string fault;
        std::vector<hapticlod::Material> made;
        if (materials) {
            made.resize(materials->shape(0));
            if (made.empty()) throw std::invalid_argument("materials are given, but there are none");
            std::memcpy(made.data(), materials->data(), made.size() * sizeof(made[0]));
        }
        {
            const std::span<const float> v{vertices.data(), vertices.size()};
            const std::span<const std::uint32_t> f{faces.data(), faces.size()};
            const nb::gil_scoped_release free_gil;
            const auto start = std::chrono::steady_clock::now();
            fault = storage_.build(v, f, cell_mm);
            if (fault.empty()) fault = storage_.set_materials(made);
            build_ms_ = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
        }
        if (!fault.empty()) throw std::invalid_argument(fault);
    }

    [[nodiscard]] LevelView view() const { return storage_.view(); }
    [[nodiscard]] double build_ms() const { return build_ms_; }

private:
    LevelStorage storage_;
    double build_ms_ = 0.0;
};

nb::bytes as_bytes(const void* data, std::size_t size) { return nb::bytes(data, size); }

nb::dict level_arrays(const Level& level) {
    const LevelView v = level.view();
    nb::dict out;
    const auto put = [&out](const char* name, const auto& span) {
        out[name] = as_bytes(span.data(), span.size_bytes());
    };
    put("vertices", v.vertices), put("faces", v.faces), put("adjacency", v.adjacency), put("normals", v.normals);
    out["hash"] = as_bytes(v.hash, sizeof(*v.hash));
    put("table", v.table), put("bricks", v.bricks), put("cells", v.cells), put("blocks", v.blocks);
    std::vector<hapticlod::BlockBound> bounds;
    for (const hapticlod::TriBlock& block : v.blocks) bounds.push_back(hapticlod::bound_of(block));
    put("bounds", std::span(bounds));
    if (!v.materials.empty()) put("materials", v.materials);
    return out;
}

class Renderer {
public:
    Renderer(const nb::list& levels, const nb::bytes& config, const Balls& balls, bool material_friction) {
        if (config.size() != sizeof(hapticlod::ConfigData)) throw std::invalid_argument("config has the wrong size");
        hapticlod::ConfigData data;
        std::memcpy(&data, config.data(), sizeof(data));
        std::vector<LevelView> views;
        for (const nb::handle level : levels) {
            views.push_back(nb::cast<const Level&>(level).view());
            keep_.append(level);
            if (material_friction || views.back().materials.empty()) continue;
            auto& smooth = smooth_.emplace_back(views.back().materials.begin(), views.back().materials.end());
            for (hapticlod::Material& m : smooth) m.friction_static = m.friction_dynamic = hapticlod::kAsStation;
            views.back().materials = smooth;
        }
        std::vector<hapticlod::BallData> tool(balls.shape(0));
        for (std::size_t i = 0; i < tool.size(); ++i) tool[i] = {{balls(i, 0), balls(i, 1), balls(i, 2)}, balls(i, 3)};
        if (const std::string fault = renderer_.load(data, views, tool); !fault.empty())
            throw std::invalid_argument(fault);
    }

    nb::bytes replay(const Times& time_s, const Positions& position_mm, const std::optional<Quaternions>& orientation,
                     int repeats, const std::optional<Floors>& floors) {
        const std::size_t n = time_s.shape(0);
        if (position_mm.shape(0) != n || (orientation && orientation->shape(0) != n) ||
            (floors && floors->shape(0) != n))
            throw std::invalid_argument("time_s, position_mm, orientation and floors differ in length");
        if (repeats < 1) throw std::invalid_argument("repeats must be at least 1");
        std::vector<hapticlod::TickRecord> rows(n);
        {
            const nb::gil_scoped_release free_gil;
            std::vector<float> least(n, std::numeric_limits<float>::max());
            for (int r = 0; r < repeats; ++r) {
                renderer_.reset();
                for (std::size_t i = 0; i < n; ++i) {
                    hapticlod::Pose pose{{position_mm(i, 0), position_mm(i, 1), position_mm(i, 2)}};
                    if (orientation)
                        for (std::size_t k = 0; k < 4; ++k) pose.orientation[k] = (*orientation)(i, k);
                    if (floors) renderer_.set_coarsest_floor((*floors)(i));
                    const auto start = std::chrono::steady_clock::now();
                    renderer_.tick(pose, time_s(i), rows[i]);
                    const std::chrono::duration<float, std::nano> ns = std::chrono::steady_clock::now() - start;
                    least[i] = std::min(least[i], ns.count());
                }
            }
            for (std::size_t i = 0; i < n; ++i) rows[i].cost_ns = least[i];
            renderer_.reset();
        }
        return as_bytes(rows.data(), rows.size() * sizeof(rows[0]));
    }

    nb::bytes tick(double time_s, const nb::ndarray<const double, nb::shape<3>, nb::device::cpu>& position_mm,
                   const std::optional<nb::ndarray<const double, nb::shape<4>, nb::device::cpu>>& orientation) {
        hapticlod::Pose pose{{position_mm(0), position_mm(1), position_mm(2)}};
        if (orientation)
            for (std::size_t k = 0; k < 4; ++k) pose.orientation[k] = (*orientation)(k);
        hapticlod::TickRecord row;
        renderer_.tick(pose, time_s, row);
        return as_bytes(&row, sizeof(row));
    }

    void reset() { renderer_.reset(); }
    void set_coarsest_floor(std::uint32_t level) { renderer_.set_coarsest_floor(level); }
    [[nodiscard]] std::size_t scratch_bytes() const { return renderer_.scratch_bytes(); }

private:
    nb::list keep_;                                         // the levels' memory must outlive the renderer
    std::vector<std::vector<hapticlod::Material>> smooth_;  // moved, their elements stay where they are
    hapticlod::Renderer renderer_;
};

}  // namespace

NB_MODULE(_runtime, m) {
    m.doc() = "HapticLOD's C++ core. Rows and configurations are bytes in the layouts of hapticlod.layout.";
    m.attr("CONFIG_SIZE") = sizeof(hapticlod::ConfigData);
    m.attr("RECORD_SIZE") = sizeof(hapticlod::TickRecord);
    m.attr("BALL_SIZE") = sizeof(hapticlod::BallData);
    m.attr("HASH_SIZE") = sizeof(hapticlod::HashHeader);
    m.attr("BRICK_SIZE") = sizeof(hapticlod::Brick);
    m.attr("BLOCK_SIZE") = sizeof(hapticlod::TriBlock);
    m.attr("BOUND_SIZE") = sizeof(hapticlod::BlockBound);
    m.attr("MATERIAL_SIZE") = sizeof(hapticlod::Material);
    m.def(
        "kernels", [] { return hapticlod::best_kernels().name; }, "Name of the kernels in use on this processor.");

    nb::class_<Level>(m, "Level", "A mesh and its voxel hash. vertices (n, 3) float32 mm, faces (m, 3) uint32.")
        .def(nb::init<const FloatRows&, const IndexRows&, double, const std::optional<FloatRows>&>(), "vertices"_a,
             "faces"_a, "cell_mm"_a, "materials"_a = nb::none(),
             "materials (n, 3) float32: stiffness N/mm, static and dynamic friction per vertex; -1: the station's.")
        .def_prop_ro("triangles", [](const Level& l) { return l.view().triangle_count(); })
        .def_prop_ro("bytes", [](const Level& l) { return l.view().bytes(); })
        .def_prop_ro("cell_mm", [](const Level& l) { return l.view().hash->cell_mm; })
        .def_prop_ro("build_ms", &Level::build_ms)
        .def("arrays", &level_arrays, "The arrays as bytes, by section name.");

    nb::class_<Renderer>(m, "Renderer", "The tick over some levels, for one tool. balls (P, 4): x, y, z, radius in mm.")
        .def(nb::init<const nb::list&, const nb::bytes&, const Balls&, bool>(), "levels"_a, "config"_a, "balls"_a,
             "material_friction"_a = true, "material_friction: false leaves the levels' own friction aside.")
        .def("replay", &Renderer::replay, "time_s"_a, "position_mm"_a, "orientation"_a = nb::none(), "repeats"_a = 1,
             "floors"_a = nb::none(), "floors (n,) uint32: the coarsest floor set before each tick.")
        .def("tick", &Renderer::tick, "time_s"_a, "position_mm"_a, "orientation"_a = nb::none())
        .def("reset", &Renderer::reset)
        .def("set_coarsest_floor", &Renderer::set_coarsest_floor, "level"_a)
        .def_prop_ro("scratch_bytes", &Renderer::scratch_bytes);
}
