#include "io/checked_files.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <sstream>
#include <string_view>

#include "io/atomic_file.hpp"
#include "io/digest.hpp"

namespace hapticlod {
namespace {

// What the checks of Bundle::open find; to be raised whenever they find more.
constexpr const char* kTitle = "hapticlod checked bundles 1";
constexpr std::size_t kMostEntries = 32;
constexpr std::size_t kMostBytes = 16384;
constexpr mode_t kOthersWrite = S_IWGRP | S_IWOTH;

// A small file, where it is a regular one of this user's that nobody else can write; else nothing.
std::string own_text(const std::string& path) {
    const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
    if (descriptor < 0) return {};
    std::string text(kMostBytes, '\0');
    struct stat status {};
    const bool own = ::fstat(descriptor, &status) == 0 && S_ISREG(status.st_mode) && status.st_uid == ::geteuid() &&
                     (status.st_mode & kOthersWrite) == 0;
    const ssize_t bytes = own ? ::read(descriptor, text.data(), text.size()) : 0;
    ::close(descriptor);
    text.resize(static_cast<std::size_t>(std::max<ssize_t>(bytes, 0)));
    return text;
}

std::string name_of_start() {
    std::string name(36, '\0');
    const int descriptor = ::open("/proc/sys/kernel/random/boot_id", O_RDONLY | O_CLOEXEC);
    if (descriptor < 0) return {};
    const ssize_t bytes = ::read(descriptor, name.data(), name.size());
    ::close(descriptor);
    return bytes == static_cast<ssize_t>(name.size()) ? name : std::string{};
}

bool same_file(const FileState& a, const FileState& b) { return a.device == b.device && a.inode == b.inode; }

}  // namespace

std::string CheckedFiles::standard_path() {
    const auto set = [](const char* name) {
        const char* value = std::getenv(name);
        return std::string(value == nullptr ? "" : value);
    };
    std::string folder = set("HAPTICLOD_CACHE");
    if (folder.empty() && !set("XDG_CACHE_HOME").empty()) folder = set("XDG_CACHE_HOME") + "/hapticlod";
    if (folder.empty() && !set("HOME").empty()) folder = set("HOME") + "/.cache/hapticlod";
    return folder.empty() ? "" : folder + "/checked_bundles";
}

CheckedFiles::CheckedFiles(std::string path, std::int64_t settled_ns)
    : path_(std::move(path)), start_(path_.empty() ? std::string{} : name_of_start()), settled_ns_(settled_ns) {
    if (start_.empty()) return;
    std::istringstream lines(own_text(path_));
    std::string line;
    if (!std::getline(lines, line) || line != kTitle || !std::getline(lines, line) || line != start_) return;
    while (entries_.size() < kMostEntries && std::getline(lines, line)) {
        std::istringstream words(line);
        Entry entry{};
        FileState& state = entry.state;
        std::string head, more;
        if (!(words >> state.device >> state.inode >> state.bytes >> state.modified_ns >> state.changed_ns >>
              state.owner >> state.mode >> head) ||
            words >> more || head.size() != 2 * entry.head.size()) {
            break;  // a damaged record is worth no more than what stands before the damage
        }
        for (std::size_t i = 0; i < entry.head.size(); ++i) {
            entry.head[i] = static_cast<std::uint8_t>(std::strtoul(head.substr(2 * i, 2).c_str(), nullptr, 16));
        }
        if (hex(entry.head) != head) break;
        entries_.push_back(entry);
    }
}

bool CheckedFiles::knows(const FileState& state, const Digest& head) const {
    return std::any_of(entries_.begin(), entries_.end(),
                       [&](const Entry& entry) { return entry.state == state && entry.head == head; });
}

void CheckedFiles::remember(const FileState& state, const Digest& head, std::int64_t began_ns) {
    if (start_.empty() || (state.mode & kOthersWrite) != 0) return;
    if (began_ns - std::max(state.changed_ns, state.modified_ns) < settled_ns_) return;
    std::erase_if(entries_, [&](const Entry& entry) { return same_file(entry.state, state); });
    entries_.insert(entries_.begin(), {state, head});
    if (entries_.size() > kMostEntries) entries_.resize(kMostEntries);
    // Where it cannot be kept the next opening takes longer, and that is all.
    std::error_code ignored;
    std::filesystem::create_directories(std::filesystem::path(path_).parent_path(), ignored);
    if (!write_file_atomic(path_, text())) ::chmod(path_.c_str(), S_IRUSR | S_IWUSR);
}

std::string CheckedFiles::text() const {
    std::ostringstream text;
    text << kTitle << '\n' << start_ << '\n';
    for (const Entry& entry : entries_) {
        const FileState& state = entry.state;
        text << state.device << ' ' << state.inode << ' ' << state.bytes << ' ' << state.modified_ns << ' '
             << state.changed_ns << ' ' << state.owner << ' ' << state.mode << ' ' << hex(entry.head) << '\n';
    }
    return text.str();
}

}  // namespace hapticlod
