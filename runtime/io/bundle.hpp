// A checked bundle, used in place: every array is a view into the mapped file, except levels whose acceleration
// sections this runtime does not know, which are rebuilt in memory.
#pragma once
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/renderer.hpp"
#include "io/checked_files.hpp"
#include "io/mapped_file.hpp"
#include "io/motion.hpp"
#include "io/section_table.hpp"
#include "io/signature.hpp"

namespace hapticlod {

class Bundle {
public:
    // Structure, digests and content are checked; nothing of a refused file is used. Spans and views live as long as
    // the Bundle and survive its being moved. Large bundles are checked by several threads, which are gone afterwards.
    [[nodiscard]] static Result<Bundle> open(const std::string& path);

    // The same, but the large arrays of a file that `known` has are not read again; a file that was found right is
    // remembered there. Structure, configuration, signature and all that is small are checked always.
    [[nodiscard]] static Result<Bundle> open(const std::string& path, CheckedFiles& known);

    // The same over bytes that the caller holds, 64-byte aligned and unchanged for as long as the Bundle lives.
    // `name` is for messages.
    [[nodiscard]] static Result<Bundle> open(std::span<const std::byte> bytes, const std::string& name);

    [[nodiscard]] const std::string& path() const { return path_; }
    [[nodiscard]] std::size_t file_bytes() const { return bytes_.size(); }
    [[nodiscard]] std::span<const std::byte> bytes() const { return bytes_; }  // the whole file
    [[nodiscard]] std::span<const Section> sections() const { return sections_; }
    // Who signed it, proved; nobody where it is unsigned or signed in a way that this program does not know.
    [[nodiscard]] const std::optional<PublicKey>& signer() const { return signer_; }
    [[nodiscard]] std::string_view manifest() const { return manifest_; }  // a JSON object, UTF-8
    [[nodiscard]] const ConfigData& config() const { return *config_; }
    [[nodiscard]] std::span<const BallData> tool() const { return tool_; }
    // Finest first; of a scene all levels of its first part, then of the next.
    [[nodiscard]] std::span<const LevelView> levels() const { return levels_; }
    // Of a scene; empty where the bundle holds one scan.
    [[nodiscard]] std::span<const PartData> parts() const { return parts_; }
    [[nodiscard]] std::optional<std::uint32_t> part_named(std::string_view name) const;
    [[nodiscard]] std::span<const LevelView> levels_of(std::uint32_t part) const;
    // Bits of the parts that are not hidden at first.
    [[nodiscard]] std::uint64_t visible() const;
    // Loads a renderer with what the bundle holds, under this configuration. The reason where it refuses.
    [[nodiscard]] std::string prepare(Renderer& renderer, const ConfigData& config) const;
    [[nodiscard]] bool checked_before() const { return checked_before_; }  // its large arrays were not read again
    [[nodiscard]] bool rebuilt(std::size_t level) const { return storage_[level] != nullptr; }
    // Empty where the bundle has none; else both have one row per tick.
    [[nodiscard]] std::span<const MotionRow> golden_motion() const { return golden_motion_; }
    [[nodiscard]] std::span<const TickRecord> golden_record() const { return golden_record_; }

private:
    Bundle() = default;
    [[nodiscard]] const Section* find(SectionType type, std::uint32_t level = 0) const;
    template <class T>
    [[nodiscard]] std::string take(SectionType type, std::uint32_t level, std::span<const T>& out) const;
    [[nodiscard]] std::string load_level(std::uint32_t stored, std::uint32_t triangles, double cell_mm);
    [[nodiscard]] std::string load_parts();
    [[nodiscard]] std::string make_parts();
    [[nodiscard]] static Result<Bundle> open(std::span<const std::byte> bytes, const std::string& name,
                                             bool checked_before);
    [[nodiscard]] std::string load();
    [[nodiscard]] std::string load_bounds();
    [[nodiscard]] std::string load_golden();
    [[nodiscard]] std::string load_signature();
    [[nodiscard]] std::optional<Fault> check_arrays() const;
    [[nodiscard]] std::string rebuild();

    std::string path_;
    std::optional<MappedFile> file_;  // where it was opened by name
    std::span<const std::byte> bytes_;
    std::vector<Section> sections_;
    std::optional<PublicKey> signer_;
    bool checked_before_ = false;
    std::string_view manifest_;
    const ConfigData* config_ = nullptr;
    std::span<const BallData> tool_;
    std::span<const PartData> parts_;
    std::vector<std::unique_ptr<Part>> scene_;  // of parts_, as the tick uses them
    std::vector<LevelView> levels_;
    std::vector<double> cells_mm_;                        // as CONFIG or PARTS says, per level
    std::vector<std::unique_ptr<LevelStorage>> storage_;  // per level; null where the file is used in place
    std::span<const MotionRow> golden_motion_;
    std::span<const TickRecord> golden_record_;
};

}  // namespace hapticlod
