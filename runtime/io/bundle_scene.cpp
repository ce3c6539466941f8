// Bundles of several parts: section PARTS, and what becomes of it.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "io/bundle.hpp"

namespace hapticlod {
namespace {

std::string_view name_of(const PartData& part) { return {part.name, ::strnlen(part.name, sizeof(part.name))}; }

bool is_name(const PartData& part) {
    const std::string_view name = name_of(part);
    if (name.empty() || name.size() == sizeof(part.name)) return false;
    return std::all_of(name.begin(), name.end(), [](char c) { return c < 0 || (c >= 32 && c != 127); }) &&
           std::all_of(part.name + name.size(), std::end(part.name), [](char c) { return c == 0; });
}

std::string part_fault(const PartData& part, const ConfigData& config) {
    if (!is_name(part)) return "has a name that is no text of 1 to 63 bytes";
    if (part.level_count < 1 || part.level_count > config.level_count) return "has a wrong number of levels";
    const bool zero = std::all_of(std::begin(part.reserved), std::end(part.reserved), [](auto v) { return v == 0; });
    if ((part.flags & ~kPartHidden) != 0 || !zero) return "has unknown flags or reserved fields that are not 0";
    double length2 = 0.0;
    for (const double q : part.orientation) length2 += q * q;
    if (!(std::abs(std::sqrt(length2) - 1.0) <= 1e-3)) return "has an orientation that is not a unit quaternion";
    for (const double v : part.position_mm)
        if (!(std::abs(v) <= 1e9)) return "has a position that is not finite or beyond 10^9 mm";
    return {};
}

}  // namespace

std::string Bundle::load_parts() {
    if (std::string reason = take(SectionType::parts, 0, parts_); !reason.empty()) return reason;
    const std::string in = "section PARTS: ";
    if (parts_.empty() || parts_.size() > kMaxParts)
        return in + std::to_string(parts_.size()) + " parts, expected 1 to 64";
    std::uint32_t stored = 0, most = 0;
    for (std::size_t i = 0; i < parts_.size(); ++i) {
        const std::string at = in + "part " + std::to_string(i) + " ";
        if (std::string reason = part_fault(parts_[i], *config_); !reason.empty()) return at + reason;
        for (std::size_t k = 0; k < i; ++k)
            if (name_of(parts_[k]) == name_of(parts_[i])) return at + "has the name of another";
        stored += parts_[i].level_count;
        most = std::max(most, parts_[i].level_count);
    }
    if (most != config_->level_count) return in + "no part has as many levels as the config";
    for (const Section& section : sections_) {
        if (is_level_section(section.entry.type) && section.entry.level >= stored)
            return "section " + section.name() + " belongs to no part";
    }
    for (std::uint32_t k = 0; k < config_->level_count; ++k) {
        std::uint64_t sum = 0;
        for (const PartData& part : parts_) sum += part.triangles[std::min(k, part.level_count - 1)];
        if (sum != config_->triangles[k])
            return in + "at level " + std::to_string(k) + " they have other triangles than the config says";
    }
    std::uint32_t level = 0;
    for (const PartData& part : parts_) {
        for (std::uint32_t k = 0; k < part.level_count; ++k, ++level)
            if (std::string reason = load_level(level, part.triangles[k], part.cell_mm[k]); !reason.empty())
                return std::string(name_of(part)) + ", " + reason;
    }
    return {};
}

// When all levels are checked and built.
std::string Bundle::make_parts() {
    for (std::uint32_t i = 0; i < parts_.size(); ++i) {
        scene_.push_back(std::make_unique<Part>(levels_of(i)));
        if (!scene_.back()->fault().empty()) return std::string(name_of(parts_[i])) + ": " + scene_.back()->fault();
    }
    return {};
}

std::span<const LevelView> Bundle::levels_of(std::uint32_t part) const {
    if (parts_.empty()) return levels_;
    std::uint32_t first = 0;
    for (std::uint32_t i = 0; i < part; ++i) first += parts_[i].level_count;
    return std::span<const LevelView>(levels_).subspan(first, parts_[part].level_count);
}

std::optional<std::uint32_t> Bundle::part_named(std::string_view name) const {
    for (std::uint32_t i = 0; i < parts_.size(); ++i)
        if (name_of(parts_[i]) == name) return i;
    return std::nullopt;
}

std::uint64_t Bundle::visible() const {
    if (parts_.empty()) return 1;
    std::uint64_t bits = 0;
    for (std::size_t i = 0; i < parts_.size(); ++i)
        if ((parts_[i].flags & kPartHidden) == 0) bits |= std::uint64_t{1} << i;
    return bits;
}

std::string Bundle::prepare(Renderer& renderer, const ConfigData& config) const {
    if (parts_.empty()) return renderer.load(config, levels_, tool_);
    std::vector<const Part*> parts;
    for (const auto& part : scene_) parts.push_back(part.get());
    return renderer.load_scene(config, parts, visible(), tool_);
}

}  // namespace hapticlod
