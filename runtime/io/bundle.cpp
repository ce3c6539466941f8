#include "io/bundle.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>

#include "core/config_check.hpp"
#include "core/material.hpp"
#include "io/digest.hpp"
#include "io/in_parallel.hpp"
#include "io/json_text.hpp"

namespace hapticlod {
namespace {

constexpr std::size_t kBlocksAtOnce = 16384;  // checked by one job
constexpr std::size_t kMostHeadBytes = sizeof(BundleHeader) + kMaxSections * sizeof(SectionEntry);
constexpr double kMostToolMm = 1e9;      // as for vertices
constexpr std::size_t kDigestsTake = 4;  // times the reading of the same bytes

// What core's check_config leaves open: a limit of 0 is none for it, which who carries a bundle to a device must not
// rely on; and fields that later formats may give a meaning must be 0 in this one.
std::string config_fault(const ConfigData& config) {
    if (std::string reason = check_config(config); !reason.empty()) return reason;
    if (!(config.max_force_n > 0.0)) return "max_force_n = 0 would be no limit: a bundle must have one";
    const bool zero =
        std::all_of(std::begin(config.reserved), std::end(config.reserved), [](double v) { return v == 0.0; });
    return zero && config.flags == 0 ? "" : "flags or reserved fields are not 0";
}

std::string tool_fault(std::span<const BallData> tool) {
    if (tool.empty() || tool.size() > kMaxBalls) return std::to_string(tool.size()) + " balls, expected 1 to 4096";
    for (std::size_t i = 0; i < tool.size(); ++i) {
        const BallData& ball = tool[i];
        const double reach = std::hypot(ball.centre_mm[0], ball.centre_mm[1], ball.centre_mm[2]);
        if (!std::isfinite(reach) || !std::isfinite(ball.radius_mm) || ball.radius_mm < 0.0) {
            return "ball " + std::to_string(i) + " is not finite or has a negative radius";
        }
        if (reach > kMostToolMm || ball.radius_mm > kMostToolMm) {
            return "ball " + std::to_string(i) + " reaches beyond 10^9 mm";
        }
    }
    return {};
}

}  // namespace

Result<Bundle> Bundle::open(const std::string& path) {
    CheckedFiles nothing({});
    return open(path, nothing);
}

Result<Bundle> Bundle::open(const std::string& path, CheckedFiles& known) {
    const std::int64_t began_ns = std::chrono::system_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
    Result<MappedFile> file = MappedFile::open(path);
    if (!file) return file.fault();
    const FileState state = file.value().state();
    const auto bytes = file.value().bytes();
    const Digest head = blake2b_256(bytes.first(std::min(bytes.size(), kMostHeadBytes)));
    Result<Bundle> bundle = open(bytes, path, known.knows(state, head));
    if (!bundle) return bundle;
    bundle.value().file_ = std::move(file).value();
    if (!bundle.value().checked_before() && file_state(path) == state) known.remember(state, head, began_ns);
    return bundle;
}

Result<Bundle> Bundle::open(std::span<const std::byte> bytes, const std::string& name) {
    return open(bytes, name, false);
}

Result<Bundle> Bundle::open(std::span<const std::byte> bytes, const std::string& name, bool checked_before) {
    if (reinterpret_cast<std::uintptr_t>(bytes.data()) % kSectionAlignment != 0) {
        return Fault{name, "does not start at a multiple of 64 bytes in memory", "align the buffer"};
    }
    Result<std::vector<Section>> sections = read_section_table(bytes, name);
    if (!sections) return sections.fault();
    Bundle bundle;
    bundle.path_ = name;
    bundle.bytes_ = bytes;
    bundle.sections_ = std::move(sections).value();
    bundle.checked_before_ = checked_before;
    if (std::string reason = bundle.load_signature(); !reason.empty()) {
        return Fault{name + ", SIGNATURE", reason, "get the bundle again from whoever signed it"};
    }
    const auto fault = [&name](std::string reason) { return Fault{name, std::move(reason), "write the bundle again"}; };
    if (std::string reason = bundle.load(); !reason.empty()) return fault(std::move(reason));
    if (!checked_before) {
        if (std::optional<Fault> found = bundle.check_arrays()) return *std::move(found);
    }
    if (std::string reason = bundle.rebuild(); !reason.empty()) return fault(std::move(reason));
    if (std::string reason = bundle.make_parts(); !reason.empty()) return fault(std::move(reason));
    return bundle;
}

const Section* Bundle::find(SectionType type, std::uint32_t level) const {
    for (const Section& section : sections_) {
        if (section.entry.type == static_cast<std::uint32_t>(type) && section.entry.level == level) {
            return section.known() ? &section : nullptr;
        }
    }
    return nullptr;
}

// A section as an array of T; the reason when it is missing or its length is no whole number of T.
template <class T>
std::string Bundle::take(SectionType type, std::uint32_t level, std::span<const T>& out) const {
    const Section* section = find(type, level);
    if (section == nullptr) {
        return std::string("section ") + section_name(static_cast<std::uint32_t>(type)) + " of level " +
               std::to_string(level) + " is missing";
    }
    if (section->bytes.size() % sizeof(T) != 0) {
        return "section " + section->name() + " has " + std::to_string(section->bytes.size()) +
               " bytes, no multiple of " + std::to_string(sizeof(T));
    }
    // Sections are 64-byte aligned in a page-aligned mapping; every T here is a plain record.
    out = {reinterpret_cast<const T*>(section->bytes.data()), section->bytes.size() / sizeof(T)};
    return {};
}

template std::string Bundle::take(SectionType, std::uint32_t, std::span<const PartData>&) const;

std::string Bundle::load_signature() {
    const Section* section = find(SectionType::signature);
    if (section == nullptr) return {};
    if (section->bytes.size() != sizeof(SignatureData)) {
        return "has " + std::to_string(section->bytes.size()) + " bytes, expected 96";
    }
    SignatureData data;
    std::memcpy(&data, section->bytes.data(), sizeof(data));
    const std::size_t signed_bytes = sizeof(BundleHeader) + sections_.size() * sizeof(SectionEntry);
    if (!verify_signature(data, bytes_.first(signed_bytes))) return "does not verify: the bundle was altered";
    signer_ = data.public_key;
    return {};
}

std::string Bundle::load() {
    std::span<const char> text;
    if (std::string reason = take(SectionType::manifest, 0, text); !reason.empty()) return reason;
    manifest_ = {text.data(), text.size()};
    if (manifest_.size() > kMaxManifestBytes || !is_json_object(manifest_)) {
        return "section MANIFEST is not a JSON object of at most 16 MiB";
    }

    std::span<const ConfigData> configs;
    if (std::string reason = take(SectionType::config, 0, configs); !reason.empty()) return reason;
    if (configs.size() != 1) return "section CONFIG holds " + std::to_string(configs.size()) + " records, expected 1";
    config_ = &configs[0];
    if (std::string reason = config_fault(*config_); !reason.empty()) return "section CONFIG: " + reason;

    if (std::string reason = take(SectionType::tool, 0, tool_); !reason.empty()) return reason;
    if (std::string reason = tool_fault(tool_); !reason.empty()) return "section TOOL: " + reason;

    for (std::uint32_t level = 0; level < config_->level_count; ++level) {
        if (config_->balls[level] > tool_.size()) {
            return "section CONFIG: level " + std::to_string(level) + " uses more balls than the tool has";
        }
    }
    if (find(SectionType::parts) != nullptr) {
        if (std::string reason = load_parts(); !reason.empty()) return reason;
        if (std::string reason = load_bounds(); !reason.empty()) return reason;
        return load_golden();
    }
    for (const Section& section : sections_) {
        if (is_level_section(section.entry.type) && section.entry.level >= config_->level_count) {
            return "section " + section.name() + " belongs to no level of the config";
        }
    }
    for (std::uint32_t level = 0; level < config_->level_count; ++level) {
        if (std::string reason = load_level(level, config_->triangles[level], config_->cell_mm[level]); !reason.empty())
            return reason;
    }
    if (std::string reason = load_bounds(); !reason.empty()) return reason;
    return load_golden();
}

std::string Bundle::load_level(std::uint32_t level, std::uint32_t triangles, double cell_mm) {
    LevelView view;
    if (std::string reason = take(SectionType::vertices, level, view.vertices); !reason.empty()) return reason;
    if (std::string reason = take(SectionType::faces, level, view.faces); !reason.empty()) return reason;
    const std::string at = "level " + std::to_string(level) + ": ";
    if (view.vertices.size() % 3 != 0 || view.faces.size() % 3 != 0) return at + "has incomplete vertices or faces";
    if (view.faces.size() / 3 != triangles) {
        return at + "has " + std::to_string(view.faces.size() / 3) + " triangles, its config says " +
               std::to_string(triangles);
    }

    if (find(SectionType::materials, level) != nullptr) {
        if (std::string reason = take(SectionType::materials, level, view.materials); !reason.empty()) return reason;
        if (view.materials.empty()) return at + "materials and vertices differ in number";
    }

    storage_.push_back(nullptr);
    cells_mm_.push_back(cell_mm);
    for (auto type = static_cast<std::uint32_t>(SectionType::adjacency); is_acceleration(type); ++type) {
        if (find(static_cast<SectionType>(type), level) == nullptr) {  // or of a version that is not known here
            levels_.push_back(view);                                   // until rebuild()
            return {};
        }
    }

    std::span<const HashHeader> header;
    if (std::string reason = take(SectionType::adjacency, level, view.adjacency); !reason.empty()) return reason;
    if (std::string reason = take(SectionType::normals, level, view.normals); !reason.empty()) return reason;
    if (std::string reason = take(SectionType::hash, level, header); !reason.empty()) return reason;
    if (std::string reason = take(SectionType::table, level, view.table); !reason.empty()) return reason;
    if (std::string reason = take(SectionType::bricks, level, view.bricks); !reason.empty()) return reason;
    if (std::string reason = take(SectionType::cells, level, view.cells); !reason.empty()) return reason;
    if (std::string reason = take(SectionType::blocks, level, view.blocks); !reason.empty()) return reason;
    if (header.size() != 1) return at + "has " + std::to_string(header.size()) + " hash headers, expected 1";
    view.hash = &header[0];
    if (std::string reason = check_level_sizes(view); !reason.empty()) return at + reason;
    for (const std::uint32_t value : view.hash->reserved) {
        if (value != 0) return at + "a reserved field of its hash is not 0";
    }
    if (view.hash->cell_mm != cell_mm) return at + "its hash has another cell_mm than its config";
    levels_.push_back(view);
    return {};
}

// Where a level is to be rebuilt its blocks are others than those of the section, which is of no use then.
std::string Bundle::load_bounds() {
    if (find(SectionType::bounds) == nullptr) return {};
    std::span<const BlockBound> bounds;
    if (std::string reason = take(SectionType::bounds, 0, bounds); !reason.empty()) return reason;
    std::size_t blocks = 0;
    for (const LevelView& level : levels_) {
        if (level.hash == nullptr) return {};
        blocks += level.blocks.size();
    }
    if (bounds.size() != blocks) return "section BOUNDS and the blocks of all levels differ in number";
    for (LevelView& level : levels_) {
        level.bounds = bounds.first(level.blocks.size());
        bounds = bounds.subspan(level.blocks.size());
    }
    return {};
}

// All that is long to read, at once: the digests of large sections and what is in the arrays of every level. The fault
// that is named does not depend on the threads: the first of a digest, else the first of a level.
std::optional<Fault> Bundle::check_arrays() const {
    std::vector<Job> jobs;
    std::vector<std::function<std::string()>> contents;  // of jobs, in the order of levels
    std::vector<std::string> found;
    std::vector<char> damaged(sections_.size(), 0);
    for (std::size_t i = 0; i < sections_.size(); ++i) {
        if (!sections_[i].large()) continue;
        jobs.push_back(
            {kDigestsTake * sections_[i].bytes.size(), [&, i] { damaged[i] = sections_[i].intact() ? 0 : 1; }});
    }
    const auto later = [&](std::uint32_t level, std::size_t bytes, auto check) {
        const std::size_t number = contents.size();
        contents.push_back([level, check] {
            std::string reason = check();
            return reason.empty() ? reason : "level " + std::to_string(level) + ": " + reason;
        });
        jobs.push_back({bytes, [&, number] { found[number] = contents[number](); }});
    };
    for (std::uint32_t level = 0; level < levels_.size(); ++level) {
        const LevelView& view = levels_[level];
        if (view.hash == nullptr) continue;  // rebuilding checks it
        later(level, view.vertices.size_bytes() + view.normals.size_bytes() + 2 * view.faces.size_bytes(),
              [&view] { return check_level_mesh(view); });
        if (!view.materials.empty()) {
            later(level, view.materials.size_bytes(),
                  [&view] { return check_materials(view.materials, view.vertex_count()); });
        }
        later(level, view.bricks.size_bytes() + view.cells.size_bytes() + view.table.size_bytes(),
              [&view] { return check_level_hash(view); });
        for (std::size_t first = 0; first < view.blocks.size(); first += kBlocksAtOnce) {
            const std::size_t last = std::min(first + kBlocksAtOnce, view.blocks.size());
            later(level, (last - first) * sizeof(TriBlock), [&view, first, last] {
                std::string reason = check_level_blocks(view, first, last);
                if (!reason.empty() || view.bounds.empty()) return reason;
                return check_bounds(view.blocks.subspan(first, last - first), view.bounds.subspan(first, last - first));
            });
        }
    }
    found.resize(contents.size());
    run_in_parallel(jobs);
    for (std::size_t i = 0; i < sections_.size(); ++i) {
        if (damaged[i] != 0) return sections_[i].damaged(path_);
    }
    for (std::string& reason : found) {
        if (!reason.empty()) return Fault{path_, std::move(reason), "write the bundle again"};
    }
    return std::nullopt;
}

// Levels whose acceleration sections are missing or of a version that is not known here.
std::string Bundle::rebuild() {
    for (std::uint32_t level = 0; level < levels_.size(); ++level) {
        LevelView& view = levels_[level];
        if (view.hash != nullptr) continue;
        auto storage = std::make_unique<LevelStorage>();
        std::string reason = check_vertices(view.vertices);
        if (reason.empty()) reason = storage->build(view.vertices, view.faces, cells_mm_[level]);
        if (reason.empty()) reason = storage->set_materials(view.materials);
        if (!reason.empty()) return "level " + std::to_string(level) + ": " + reason;
        view = storage->view();
        storage_[level] = std::move(storage);
    }
    return {};
}

std::string Bundle::load_golden() {
    const Section* motion = find(SectionType::golden_motion);
    const Section* record = find(SectionType::golden_record);
    if (motion != nullptr) {
        if (std::string reason = take(SectionType::golden_motion, 0, golden_motion_); !reason.empty()) return reason;
        if (std::string reason = check_motion(golden_motion_); !reason.empty())
            return "section GOLDEN_MOTION: " + reason;
    }
    if (record == nullptr) return {};
    if (std::string reason = take(SectionType::golden_record, 0, golden_record_); !reason.empty()) return reason;
    if (golden_record_.size() != golden_motion_.size()) {
        return "section GOLDEN_RECORD has " + std::to_string(golden_record_.size()) + " rows, the golden motion " +
               std::to_string(golden_motion_.size());
    }
    for (std::size_t i = 0; i < golden_record_.size(); ++i) {
        const TickRecord& row = golden_record_[i];
        bool finite = std::isfinite(row.time_s) && std::isfinite(row.speed_mm_s) && std::isfinite(row.cost_ns);
        for (int axis = 0; axis < 3; ++axis) {
            finite = finite && std::isfinite(row.hip_mm[axis]) && std::isfinite(row.scp_mm[axis]) &&
                     std::isfinite(row.force_n[axis]) && std::isfinite(row.torque_n_mm[axis]);
        }
        if (!finite || row.level >= config_->level_count || row.mapping > 3) {
            return "section GOLDEN_RECORD: row " + std::to_string(i + 1) + " is damaged";
        }
    }
    return {};
}

}  // namespace hapticlod
