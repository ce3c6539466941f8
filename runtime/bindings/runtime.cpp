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
using Masks = nb::ndarray<const std::uint64_t, nb::shape<-1>, nb::c_contig, nb::device::cpu>;
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

// What a scene shows at one of its levels: a level of each part, in the order of the parts.
class SceneLevel {
public:
    SceneLevel(const nb::list& parts, double cell_mm, std::uint64_t hidden)
        : parts_(parts), cell_mm_(cell_mm), hidden_(hidden) {
        if (parts.size() == 0 || parts.size() > hapticlod::kMaxParts)
            throw std::invalid_argument("a scene needs 1 to 64 parts");
        for (const nb::handle part : parts) {
            const auto& level = nb::cast<const Level&>(part);
            triangles_ += level.view().triangle_count(), bytes_ += level.view().bytes(), build_ms_ += level.build_ms();
        }
    }
    [[nodiscard]] const nb::list& parts() const { return parts_; }
    [[nodiscard]] std::size_t triangles() const { return triangles_; }
    [[nodiscard]] std::size_t bytes() const { return bytes_; }
    [[nodiscard]] double cell_mm() const { return cell_mm_; }
    [[nodiscard]] double build_ms() const { return build_ms_; }
    [[nodiscard]] std::uint64_t hidden() const { return hidden_; }

private:
    nb::list parts_;
    std::size_t triangles_ = 0, bytes_ = 0;
    double cell_mm_ = 0.0, build_ms_ = 0.0;
    std::uint64_t hidden_ = 0;
};

class Renderer {
public:
    Renderer(const nb::list& levels, const nb::bytes& config, const Balls& balls, bool material_friction)
        : material_friction_(material_friction) {
        if (config.size() != sizeof(hapticlod::ConfigData)) throw std::invalid_argument("config has the wrong size");
        hapticlod::ConfigData data;
        std::memcpy(&data, config.data(), sizeof(data));
        std::vector<hapticlod::BallData> tool(balls.shape(0));
        for (std::size_t i = 0; i < tool.size(); ++i) tool[i] = {{balls(i, 0), balls(i, 1), balls(i, 2)}, balls(i, 3)};
        const bool scene = levels.size() > 0 && nb::isinstance<SceneLevel>(levels[0]);
        const std::string fault = scene ? load_parts(levels, data, tool) : renderer_.load(data, views_of(levels), tool);
        if (!fault.empty()) throw std::invalid_argument(fault);
    }

    // Bits of the parts that are to be seen from the next tick on.
    void show(std::uint64_t visible) { renderer_.show(visible); }
    [[nodiscard]] std::uint64_t visible() const { return renderer_.visible(); }
    [[nodiscard]] std::uint64_t touched() const { return renderer_.touched(); }

    // From the next tick on the part has these levels, finest first.
    void exchange(std::uint32_t part, const nb::list& levels) {
        auto next = std::make_unique<hapticlod::Part>(views_of(levels));
        if (const std::string fault = renderer_.refusal(part, *next); !fault.empty())
            throw std::invalid_argument(fault);
        renderer_.exchange(part, *next);
        parts_.push_back(std::move(next));  // the one before may be in use elsewhere: none is given back
    }

    nb::bytes replay(const Times& time_s, const Positions& position_mm, const std::optional<Quaternions>& orientation,
                     int repeats, const std::optional<Floors>& floors, const std::optional<Masks>& visible) {
        const std::size_t n = time_s.shape(0);
        if (position_mm.shape(0) != n || (orientation && orientation->shape(0) != n) ||
            (floors && floors->shape(0) != n) || (visible && visible->shape(0) != n))
            throw std::invalid_argument("time_s, position_mm, orientation, floors and visible differ in length");
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
                    if (visible && (*visible)(i) != renderer_.visible()) renderer_.show((*visible)(i));
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
    std::vector<LevelView> views_of(const nb::list& levels) {
        std::vector<LevelView> views;
        for (const nb::handle level : levels) {
            views.push_back(nb::cast<const Level&>(level).view());
            keep_.append(level);
            if (material_friction_ || views.back().materials.empty()) continue;
            auto& smooth = smooth_.emplace_back(views.back().materials.begin(), views.back().materials.end());
            for (hapticlod::Material& m : smooth) m.friction_static = m.friction_dynamic = hapticlod::kAsStation;
            views.back().materials = smooth;
        }
        return views;
    }

    // A part whose level stays the same from some scene level on has it once.
    std::string load_parts(const nb::list& levels, const hapticlod::ConfigData& data,
                           const std::vector<hapticlod::BallData>& tool) {
        if (levels.size() != data.level_count) return "the number of levels differs from level_count";
        std::vector<nb::list> of_part;
        for (const nb::handle item : levels) {
            const auto& level = nb::cast<const SceneLevel&>(item);
            if (of_part.empty()) of_part.resize(level.parts().size());
            if (level.parts().size() != of_part.size()) return "the levels differ in their number of parts";
            for (std::size_t i = 0; i < of_part.size(); ++i) {
                const nb::handle next = level.parts()[i];
                if (of_part[i].size() == 0 || !of_part[i][of_part[i].size() - 1].is(next)) of_part[i].append(next);
            }
        }
        std::vector<const hapticlod::Part*> pointers;
        for (const nb::list& own : of_part)
            pointers.push_back(parts_.emplace_back(std::make_unique<hapticlod::Part>(views_of(own))).get());
        return renderer_.load_scene(data, pointers, ~nb::cast<const SceneLevel&>(levels[0]).hidden(), tool);
    }

    bool material_friction_;
    std::vector<std::unique_ptr<hapticlod::Part>> parts_;
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

    nb::class_<SceneLevel>(m, "SceneLevel", "A level of each part of a scene; cell_mm stands for all of them.")
        .def(nb::init<const nb::list&, double, std::uint64_t>(), "parts"_a, "cell_mm"_a, "hidden"_a = 0,
             "hidden: a bit for each part that is not to be seen at first (of the finest level).")
        .def_prop_ro("parts", &SceneLevel::parts)
        .def_prop_ro("triangles", &SceneLevel::triangles)
        .def_prop_ro("bytes", &SceneLevel::bytes)
        .def_prop_ro("cell_mm", &SceneLevel::cell_mm)
        .def_prop_ro("build_ms", &SceneLevel::build_ms);

    nb::class_<Renderer>(
        m, "Renderer",
        "The tick over some levels (or scene levels), for one tool. balls (P, 4): x, y, z, radius in mm.")
        .def(nb::init<const nb::list&, const nb::bytes&, const Balls&, bool>(), "levels"_a, "config"_a, "balls"_a,
             "material_friction"_a = true, "material_friction: false leaves the levels' own friction aside.")
        .def("replay", &Renderer::replay, "time_s"_a, "position_mm"_a, "orientation"_a = nb::none(), "repeats"_a = 1,
             "floors"_a = nb::none(), "visible"_a = nb::none(),
             "floors (n,) uint32: the coarsest floor, visible (n,) uint64: a bit per part, set before each tick.")
        .def("tick", &Renderer::tick, "time_s"_a, "position_mm"_a, "orientation"_a = nb::none())
        .def("reset", &Renderer::reset)
        .def("show", &Renderer::show, "visible"_a, "A bit per part, from the next tick on.")
        .def("exchange", &Renderer::exchange, "part"_a, "levels"_a, "From the next tick on the part has these levels.")
        .def_prop_ro("visible", &Renderer::visible)
        .def_prop_ro("touched", &Renderer::touched)
        .def("set_coarsest_floor", &Renderer::set_coarsest_floor, "level"_a)
        .def_prop_ro("scratch_bytes", &Renderer::scratch_bytes);
}
