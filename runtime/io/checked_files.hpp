// Which bundles were found right on this machine since it was started, so that 200 MB need not be hashed again on every
// start of a station.
//
// A file is known while its device, inode, size, times and front (header, table of digests) are those that were
// checked. Every write through the file system moves its time of change, which no user can set. What this cannot see,
// an opening without it would: a disk that rots between two openings, or a program that keeps the file mapped and
// writes to it (which alters it under a running station as well). So the record ends with the machine's start, and what
// others than the owner can write is never in it. The record is believed like a file of trusted keys: only where this
// user alone can write it.
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "io/bundle_format.hpp"
#include "io/mapped_file.hpp"

namespace hapticlod {

class CheckedFiles {
public:
    // The record's path; it need not exist. A record that cannot be used counts as empty.
    explicit CheckedFiles(std::string path, std::int64_t settled_ns = 2'000'000'000);

    // `head` is the digest of the front of the file, which holds header and section table.
    [[nodiscard]] bool knows(const FileState& state, const Digest& head) const;

    // After a file was found right. Does nothing where it could be changed unseen: it changed less than `settled_ns`
    // before `began_ns` (clocks of file systems are coarse), others can write it, or the record cannot be kept.
    void remember(const FileState& state, const Digest& head, std::int64_t began_ns);

    // $HAPTICLOD_CACHE/checked_bundles, or in the user's cache folder; empty where there is no such folder.
    [[nodiscard]] static std::string standard_path();

private:
    struct Entry {
        FileState state;
        Digest head;
    };
    [[nodiscard]] std::string text() const;

    std::string path_;
    std::string start_;  // of the machine: its boot's name; empty where it is not known, then nothing is kept
    std::int64_t settled_ns_;
    std::vector<Entry> entries_;  // latest first
};

}  // namespace hapticlod
