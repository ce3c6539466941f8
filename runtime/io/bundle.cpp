#include "io/bundle.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "core/config_check.hpp"
#include "io/json_text.hpp"

namespace hapticlod {
namespace {

constexpr float kMostCoordinateMm = 1e9f;

// What core's check_config leaves open: fields that later formats may give a meaning must be 0 in this one.
std::string config_fault(const ConfigData& config) {
    if (std::string reason = check_config(config); !reason.empty()) return reason;
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
    }
    return {};
}

}  // namespace

Result<Bundle> Bundle::open(const std::string& path) {
    Result<MappedFile> file = MappedFile::open(path);
    if (!file) return file.fault();
    Result<Bundle> bundle = open(file.value().bytes(), path);
    if (bundle) bundle.value().file_ = std::move(file).value();
    return bundle;
}

Result<Bundle> Bundle::open(std::span<const std::byte> bytes, const std::string& name) {
    if (reinterpret_cast<std::uintptr_t>(bytes.data()) % kSectionAlignment != 0) {
        return Fault{name, "does not start at a multiple of 64 bytes in memory", "align the buffer"};
    }
    Result<std::vector<Section>> sections = read_section_table(bytes, name);
    if (!sections) return sections.fault();
    Bundle bundle;
    bundle.path_ = name;
    bundle.bytes_ = bytes;
    bundle.sections_ = std::move(sections).value();
    if (std::string reason = bundle.load_signature(); !reason.empty()) {
        return Fault{name + ", SIGNATURE", reason, "get the bundle again from whoever signed it"};
    }
    if (std::string reason = bundle.load(); !reason.empty()) return Fault{name, reason, "write the bundle again"};
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
    return load_golden();
}

std::string Bundle::load_level(std::uint32_t level, std::uint32_t triangles, double cell_mm) {
    LevelView view;
    if (std::string reason = take(SectionType::vertices, level, view.vertices); !reason.empty()) return reason;
    if (std::string reason = take(SectionType::faces, level, view.faces); !reason.empty()) return reason;
    const std::string at = "level " + std::to_string(level) + ": ";
    if (view.vertices.size() % 3 != 0 || view.faces.size() % 3 != 0) return at + "has incomplete vertices or faces";
    for (const float v : view.vertices) {
        if (!(std::abs(v) <= kMostCoordinateMm)) return at + "a vertex is not finite or beyond 10^9 mm";
    }
    if (view.faces.size() / 3 != triangles) {
        return at + "has " + std::to_string(view.faces.size() / 3) + " triangles, its config says " +
               std::to_string(triangles);
    }

    if (find(SectionType::materials, level) != nullptr) {
        if (std::string reason = take(SectionType::materials, level, view.materials); !reason.empty()) return reason;
        if (view.materials.empty()) return at + "materials and vertices differ in number";
    }

    bool usable = true;  // every acceleration section is there in a version that this runtime knows
    for (auto type = static_cast<std::uint32_t>(SectionType::adjacency); is_acceleration(type); ++type) {
        usable = usable && find(static_cast<SectionType>(type), level) != nullptr;
    }
    if (!usable) {
        auto storage = std::make_unique<LevelStorage>();
        std::string reason = storage->build(view.vertices, view.faces, cell_mm);
        if (reason.empty()) reason = storage->set_materials(view.materials);
        if (!reason.empty()) return at + reason;
        levels_.push_back(storage->view());
        storage_.push_back(std::move(storage));
        return {};
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
    if (std::string reason = check_level(view); !reason.empty()) return at + reason;
    for (const std::uint32_t value : view.hash->reserved) {
        if (value != 0) return at + "a reserved field of its hash is not 0";
    }
    if (view.hash->cell_mm != cell_mm) return at + "its hash has another cell_mm than its config";
    levels_.push_back(view);
    storage_.push_back(nullptr);
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
