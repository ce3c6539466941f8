#include "io/section_table.hpp"

#include <algorithm>
#include <cstring>

#include "core/layout.hpp"
#include "io/digest.hpp"

namespace hapticlod {
namespace {

constexpr const char* kCopyAgain = "copy or write the bundle again";
constexpr std::size_t kLargeBytes = 65536;
constexpr const char* kUpdate = "update this program or write the bundle with an older one";

Result<BundleHeader> read_header(std::span<const std::byte> file, const std::string& path) {
    if (file.size() < sizeof(BundleHeader)) {
        return Fault{path, "is cut short: " + std::to_string(file.size()) + " bytes, the header alone has 64",
                     kCopyAgain};
    }
    BundleHeader header;
    std::memcpy(&header, file.data(), sizeof(header));
    if (header.magic != kBundleMagic) return Fault{path, "is not a HapticLOD bundle", "name a .hlod file"};
    if (header.version != kBundleVersion) {
        return Fault{path,
                     "has bundle format " + std::to_string(header.version) + ", this program reads format " +
                         std::to_string(kBundleVersion),
                     kUpdate};
    }
    if (header.file_bytes != file.size()) {
        return Fault{path,
                     "has " + std::to_string(file.size()) + " bytes, its header promises " +
                         std::to_string(header.file_bytes) + ": cut short or damaged",
                     kCopyAgain};
    }
    if (header.section_count == 0 || header.section_count > kMaxSections ||
        header.table_offset != sizeof(BundleHeader) ||
        (file.size() - sizeof(BundleHeader)) / sizeof(SectionEntry) < header.section_count) {
        return Fault{path, "has a damaged header (section count or table place)", kCopyAgain};
    }
    return header;
}

// The reason why an entry cannot be right; empty when it can. `end` is where the previous section ended.
std::string entry_fault(const SectionEntry& entry, std::uint64_t end, std::uint64_t file_bytes, bool scene) {
    const std::uint64_t aligned = (end + kSectionAlignment - 1) / kSectionAlignment * kSectionAlignment;
    if (entry.offset != aligned) return "does not start where the one before ends";
    if (entry.offset > file_bytes || entry.length > file_bytes - entry.offset) return "reaches beyond the file";
    if ((entry.flags & ~kSectionOptional) != 0) return "has unknown flags";
    // A type that is not known here may be one of levels.
    const bool of_no_level = std::strcmp(section_name(entry.type), "unknown") != 0 && !is_level_section(entry.type);
    if (entry.level >= (scene ? kMaxStoredLevels : kMaxLevels) || (entry.level != 0 && of_no_level))
        return "has a wrong level";
    return {};
}

}  // namespace

std::string Section::name() const {
    const std::string type = section_name(entry.type);
    if (type == "unknown") return "section type " + std::to_string(entry.type);
    return is_level_section(entry.type) ? type + " of level " + std::to_string(entry.level) : type;
}

bool Section::known() const {
    return std::strcmp(section_name(entry.type), "unknown") != 0 && entry.version == kSectionVersion;
}

bool Section::large() const {
    const bool array = is_level_section(entry.type) || entry.type == static_cast<std::uint32_t>(SectionType::bounds);
    return array && bytes.size() > kLargeBytes;
}

bool Section::intact() const {
    const bool signature = entry.type == static_cast<std::uint32_t>(SectionType::signature);
    return entry.digest == (signature ? Digest{} : blake2b_256(bytes));
}

Fault Section::damaged(const std::string& path) const {
    return {path + ", " + name(), "is damaged (its digest differs)", kCopyAgain};
}

Result<std::vector<Section>> read_section_table(std::span<const std::byte> file, const std::string& path) {
    const Result<BundleHeader> read = read_header(file, path);
    if (!read) return read.fault();
    const BundleHeader& header = read.value();
    const auto table = file.subspan(header.table_offset, header.section_count * sizeof(SectionEntry));
    if (blake2b_256(table) != header.table_digest) {
        return Fault{path, "has a damaged section table (its digest differs)", kCopyAgain};
    }

    std::vector<Section> sections(header.section_count);
    bool scene = false;
    for (std::size_t i = 0; i < sections.size(); ++i) {
        std::memcpy(&sections[i].entry, table.data() + i * sizeof(SectionEntry), sizeof(SectionEntry));
        scene = scene || sections[i].entry.type == static_cast<std::uint32_t>(SectionType::parts);
    }
    std::uint64_t end = header.table_offset + table.size();
    for (std::size_t i = 0; i < sections.size(); ++i) {
        Section& section = sections[i];
        const SectionEntry& entry = section.entry;
        const std::string where = path + ", " + section.name();
        if (std::string fault = entry_fault(entry, end, file.size(), scene); !fault.empty()) {
            return Fault{where, fault, kCopyAgain};
        }
        if (!section.known() && (entry.flags & kSectionOptional) == 0) {
            return Fault{where,
                         "is needed and has version " + std::to_string(entry.version) + ", which this program " +
                             "does not know",
                         kUpdate};
        }
        const auto same = [&entry](const Section& other) {
            return other.entry.type == entry.type && other.entry.level == entry.level;
        };
        if (std::any_of(sections.begin(), sections.begin() + static_cast<std::ptrdiff_t>(i), same)) {
            return Fault{where, "appears twice", kCopyAgain};
        }
        const auto padding = file.subspan(end, entry.offset - end);
        if (std::any_of(padding.begin(), padding.end(), [](std::byte b) { return b != std::byte{0}; })) {
            return Fault{where, "follows padding that is not zero", kCopyAgain};
        }
        section.bytes = file.subspan(entry.offset, entry.length);
        end = entry.offset + entry.length;
    }
    if (end != file.size()) return Fault{path, "has bytes after its last section", kCopyAgain};

    for (const Section& section : sections) {
        if (!section.large() && !section.intact()) return section.damaged(path);
    }
    return sections;
}

}  // namespace hapticlod
