// Any bytes as a bundle: refused, or rendered harmlessly. Bytes are tried as they are and once more with all sizes and
// digests made right, so that mutations get past the checks against accidents to those against intent.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <memory>

#include "core/renderer.hpp"
#include "io/bundle.hpp"
#include "io/digest.hpp"

namespace hapticlod {
namespace {

constexpr std::size_t kTicks = 8;

// What a bundle that was taken must keep: finite forces within its own limit.
void render(const Bundle& bundle) {
    Renderer renderer;
    if (!bundle.prepare(renderer, bundle.config()).empty()) return;
    const auto motion = bundle.golden_motion();
    for (std::size_t i = 0; i < std::min(kTicks, motion.size()); ++i) {
        Pose pose;
        std::copy_n(motion[i].position_mm, 3, pose.position_mm);
        std::copy_n(motion[i].orientation, 4, pose.orientation);
        TickRecord record;
        renderer.tick(pose, motion[i].time_s, record);
        const double force_n = std::hypot(record.force_n[0], record.force_n[1], record.force_n[2]);
        if (!(force_n <= bundle.config().max_force_n * (1.0 + 1e-9))) std::abort();
    }
}

void open(std::span<const std::byte> file) {
    if (const auto bundle = Bundle::open(file, "fuzz")) render(bundle.value());
}

// Sizes, places and digests as they must be for the table's types, levels and lengths.
void seal(std::span<std::byte> file) {
    BundleHeader header;
    if (file.size() < sizeof(header)) return;
    std::memcpy(&header, file.data(), sizeof(header));
    header.magic = kBundleMagic;
    header.version = kBundleVersion;
    header.file_bytes = file.size();
    header.table_offset = sizeof(header);
    const std::size_t room = (file.size() - sizeof(header)) / sizeof(SectionEntry);
    header.section_count = static_cast<std::uint32_t>(std::min<std::size_t>({header.section_count, room, 32}));
    std::size_t end = sizeof(header) + header.section_count * sizeof(SectionEntry);
    for (std::uint32_t i = 0; i < header.section_count; ++i) {
        std::byte* place = file.data() + sizeof(header) + i * sizeof(SectionEntry);
        SectionEntry entry;
        std::memcpy(&entry, place, sizeof(entry));
        entry.offset = (end + kSectionAlignment - 1) / kSectionAlignment * kSectionAlignment;
        if (entry.offset > file.size()) return;
        const std::uint64_t left = file.size() - entry.offset;
        entry.length = i + 1 == header.section_count ? left : std::min(entry.length, left);
        std::fill(file.begin() + static_cast<std::ptrdiff_t>(end),
                  file.begin() + static_cast<std::ptrdiff_t>(entry.offset), std::byte{0});
        entry.digest = entry.type == static_cast<std::uint32_t>(SectionType::signature)
                           ? Digest{}
                           : blake2b_256(file.subspan(entry.offset, entry.length));
        std::memcpy(place, &entry, sizeof(entry));
        end = entry.offset + entry.length;
    }
    header.table_digest = blake2b_256(file.subspan(sizeof(header), header.section_count * sizeof(SectionEntry)));
    std::memcpy(file.data(), &header, sizeof(header));
}

}  // namespace
}  // namespace hapticlod

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    // Of exactly this size: the sanitizer sees the first byte that is read beyond it.
    void* place = nullptr;
    if (::posix_memalign(&place, 64, size) != 0) return 0;
    const std::unique_ptr<std::byte[], decltype(&std::free)> copy(static_cast<std::byte*>(place), &std::free);
    if (size > 0) std::memcpy(copy.get(), data, size);
    const std::span<std::byte> file(copy.get(), size);
    hapticlod::open(file);
    hapticlod::seal(file);
    hapticlod::open(file);
    return 0;
}
