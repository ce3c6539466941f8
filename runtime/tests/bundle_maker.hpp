// Writes small bundles for tests, right ones and wrong ones: sections can be changed before they are sealed.
#pragma once
#include <unistd.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/occupancy.hpp"
#include "core/renderer.hpp"
#include "io/bundle_format.hpp"
#include "io/digest.hpp"
#include "io/motion.hpp"

namespace hapticlod::test {

struct MadeSection {
    SectionType type;
    std::uint32_t level = 0;
    std::string bytes;
    std::uint32_t version = kSectionVersion;
    std::uint32_t flags = 0;
};

struct MadeBundle {
    std::vector<MadeSection> sections;

    [[nodiscard]] MadeSection& at(SectionType type, std::uint32_t level = 0) {
        for (MadeSection& section : sections) {
            if (section.type == type && section.level == level) return section;
        }
        sections.push_back({type, level, ""});
        return sections.back();
    }
    template <class T>
    [[nodiscard]] T* as(SectionType type, std::uint32_t level = 0) {
        return reinterpret_cast<T*>(at(type, level).bytes.data());
    }

    // The whole file, with digests that match. `entry_change` may spoil table entries before they are sealed.
    template <class Change>
    [[nodiscard]] std::string sealed(Change&& entry_change) const {
        std::vector<SectionEntry> entries;
        std::string body;
        const std::size_t start = sizeof(BundleHeader) + sections.size() * sizeof(SectionEntry);
        for (const MadeSection& section : sections) {
            body.resize((body.size() + 63) / 64 * 64, '\0');
            SectionEntry entry{static_cast<std::uint32_t>(section.type),
                               section.version,
                               section.level,
                               section.flags,
                               start + body.size(),
                               section.bytes.size(),
                               {}};
            if (section.type != SectionType::signature)
                entry.digest = blake2b_256(std::as_bytes(std::span(section.bytes)));
            entry_change(entry);
            entries.push_back(entry);
            body += section.bytes;
        }
        BundleHeader header{kBundleMagic,        kBundleVersion,       static_cast<std::uint32_t>(entries.size()),
                            start + body.size(), sizeof(BundleHeader), {}};
        header.table_digest = blake2b_256(std::as_bytes(std::span(entries)));
        std::string file(start, '\0');
        std::memcpy(file.data(), &header, sizeof(header));
        std::memcpy(file.data() + sizeof(header), entries.data(), entries.size() * sizeof(SectionEntry));
        return file + body;
    }
    [[nodiscard]] std::string sealed() const {
        return sealed([](SectionEntry&) {});
    }
};

template <class T>
std::string bytes_of(std::span<const T> values) {
    return {reinterpret_cast<const char*>(values.data()), values.size_bytes()};
}

// A plate of 10 x 10 mm around the origin, facing up, `cells` x `cells` squares of two triangles.
inline LevelStorage plate(unsigned cells, double cell_mm, float z_mm = 0.0f) {
    std::vector<float> vertices;
    std::vector<std::uint32_t> faces;
    for (unsigned j = 0; j <= cells; ++j) {
        for (unsigned i = 0; i <= cells; ++i) {
            const float side = 10.0f / static_cast<float>(cells);
            vertices.insert(vertices.end(),
                            {side * static_cast<float>(i) - 5.0f, side * static_cast<float>(j) - 5.0f, z_mm});
        }
    }
    for (unsigned j = 0; j < cells; ++j) {
        for (unsigned i = 0; i < cells; ++i) {
            const std::uint32_t a = j * (cells + 1) + i, b = a + 1, c = a + cells + 1, d = c + 1;
            faces.insert(faces.end(), {a, b, d, a, d, c});
        }
    }
    LevelStorage level;
    const std::string reason = level.build(vertices, faces, cell_mm);
    if (!reason.empty()) throw std::runtime_error(reason);
    return level;
}

// Two plates as levels, a point tool, 1 kHz, and 200 ticks of touching the plate at speeds that use both levels.
inline ConfigData plate_config() {
    ConfigData config{};
    config.version = kConfigVersion;
    config.level_count = 2;
    config.mapping = static_cast<std::uint32_t>(Mapping::two_sided);
    config.origin_mm[2] = 20.0;
    config.loop_hz = 1000.0;
    config.budget_us = 500.0;
    config.stiffness_n_mm = 1.0;
    config.filter_hz = 30.0;
    config.hysteresis = 0.1;
    config.l_in_mm = config.l_out_mm = config.closest_bound_mm = 0.5;
    config.blend_s = 0.02;
    config.max_force_n = 4.0;
    config.speeds_mm_s[0] = 20.0;
    config.cell_mm[0] = 1.5;
    config.cell_mm[1] = 3.0;
    config.triangles[0] = 2 * 6 * 6;
    config.triangles[1] = 2 * 3 * 3;
    config.balls[0] = config.balls[1] = 1;
    return config;
}

inline std::vector<MotionRow> plate_motion(std::size_t ticks = 200) {
    std::vector<MotionRow> rows(ticks);
    for (std::size_t i = 0; i < ticks; ++i) {
        const double t = static_cast<double>(i) * 1e-3;
        rows[i] = {t, {3.0 * std::sin(12.0 * t), 1.0, 20.0 - 0.4 * std::sin(30.0 * t)}, {1.0, 0.0, 0.0, 0.0}};
    }
    return rows;
}

inline std::vector<TickRecord> render(Renderer& renderer, std::span<const MotionRow> rows) {
    std::vector<TickRecord> records(rows.size());
    for (std::size_t i = 0; i < rows.size(); ++i) {
        Pose pose;
        std::memcpy(pose.position_mm, rows[i].position_mm, sizeof(pose.position_mm));
        std::memcpy(pose.orientation, rows[i].orientation, sizeof(pose.orientation));
        renderer.tick(pose, rows[i].time_s, records[i]);
    }
    return records;
}

// Two materials, told apart by x, and vertices that say nothing.
inline std::vector<Material> two_materials(const LevelView& level) {
    std::vector<Material> made(level.vertex_count());
    for (std::size_t i = 0; i < made.size(); ++i) {
        const float x = level.vertices[3 * i];
        made[i] = x < -2.0f  ? Material{0.4f, 0.3f, 0.2f}
                  : x < 2.0f ? Material{0.8f, 0.1f, 0.1f}
                             : Material{kAsStation, kAsStation, kAsStation};
    }
    return made;
}

// `cells` squares along a side of the finer level.
inline MadeBundle plate_bundle(bool with_materials = false, unsigned cells = 6) {
    ConfigData config = plate_config();
    for (const unsigned i : {0u, 1u}) {
        const unsigned squares = cells >> i;
        config.triangles[i] = 2 * squares * squares;
        config.cell_mm[i] = 9.0 / squares;
    }
    const std::vector<BallData> tool(1);
    const std::vector<LevelStorage> storage = [with_materials, cells, &config] {
        std::vector<LevelStorage> levels;
        levels.push_back(plate(cells, config.cell_mm[0]));
        levels.push_back(plate(cells / 2, config.cell_mm[1]));
        for (LevelStorage& level : levels) {
            if (!with_materials) continue;
            const std::string fault = level.set_materials(two_materials(level.view()));
            if (!fault.empty()) throw std::runtime_error(fault);
        }
        return levels;
    }();
    const std::vector<LevelView> levels = {storage[0].view(), storage[1].view()};
    Renderer renderer;
    const std::string reason = renderer.load(config, levels, tool);
    if (!reason.empty()) throw std::runtime_error(reason);
    const std::vector<MotionRow> motion = plate_motion();
    const std::vector<TickRecord> record = render(renderer, motion);

    MadeBundle made;
    made.at(SectionType::manifest).bytes = R"({"scan": "plate"})";
    made.at(SectionType::config).bytes = bytes_of(std::span<const ConfigData>(&config, 1));
    made.at(SectionType::tool).bytes = bytes_of(std::span(tool));
    for (std::uint32_t i = 0; i < 2; ++i) {
        const LevelView& level = levels[i];
        made.at(SectionType::vertices, i).bytes = bytes_of(level.vertices);
        made.at(SectionType::faces, i).bytes = bytes_of(level.faces);
        made.at(SectionType::adjacency, i).bytes = bytes_of(level.adjacency);
        made.at(SectionType::normals, i).bytes = bytes_of(level.normals);
        made.at(SectionType::hash, i).bytes = bytes_of(std::span(level.hash, 1));
        made.at(SectionType::table, i).bytes = bytes_of(level.table);
        made.at(SectionType::bricks, i).bytes = bytes_of(level.bricks);
        made.at(SectionType::cells, i).bytes = bytes_of(level.cells);
        made.at(SectionType::blocks, i).bytes = bytes_of(level.blocks);
        if (with_materials) made.at(SectionType::materials, i).bytes = bytes_of(level.materials);
    }
    std::vector<BlockBound> bounds;
    for (const LevelView& level : levels) {
        for (const TriBlock& block : level.blocks) bounds.push_back(bound_of(block));
    }
    made.at(SectionType::bounds).bytes = bytes_of(std::span<const BlockBound>(bounds));
    made.at(SectionType::golden_motion).bytes = bytes_of(std::span(motion));
    made.at(SectionType::golden_record).bytes = bytes_of(std::span(record));
    for (MadeSection& section : made.sections) {
        const auto type = static_cast<std::uint32_t>(section.type);
        if (is_acceleration(type) || type >= static_cast<std::uint32_t>(SectionType::bounds)) {
            section.flags = kSectionOptional;
        }
    }
    return made;
}

// A file that is removed with the object.
class TemporaryFile {
public:
    explicit TemporaryFile(std::string_view content) {
        const int descriptor = ::mkstemp(path_.data());
        if (descriptor < 0) throw std::runtime_error("no temporary file");
        ::close(descriptor);
        std::ofstream(path_, std::ios::binary) << content;
    }
    ~TemporaryFile() { ::unlink(path_.c_str()); }
    TemporaryFile(const TemporaryFile&) = delete;
    TemporaryFile& operator=(const TemporaryFile&) = delete;
    [[nodiscard]] const std::string& path() const { return path_; }

private:
    // In memory where there is such a place: some tests write thousands of files.
    std::string path_ = std::string(::access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp") + "/hapticlod-test-XXXXXX";
};

}  // namespace hapticlod::test
