// A file mapped read-only. The mapping outlives the name: a bundle that is replaced by rename stays readable.
#pragma once
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "io/result.hpp"

namespace hapticlod {

// Which file it was, and in which state: any change of its content through the file system gives another one.
struct FileState {
    std::uint64_t device, inode, bytes;
    std::int64_t modified_ns, changed_ns;  // since 1970; the latter is the system's and cannot be set
    std::uint32_t owner, mode;

    friend bool operator==(const FileState&, const FileState&) = default;
};

// Nothing where there is no regular file of this name.
[[nodiscard]] std::optional<FileState> file_state(const std::string& path);

class MappedFile {
public:
    [[nodiscard]] static Result<MappedFile> open(const std::string& path);
    MappedFile(MappedFile&& other) noexcept;
    MappedFile& operator=(MappedFile&& other) noexcept;
    ~MappedFile();

    [[nodiscard]] std::span<const std::byte> bytes() const { return {data_, size_}; }
    [[nodiscard]] const FileState& state() const { return state_; }  // when it was opened

private:
    MappedFile(const std::byte* data, const FileState& state) : data_(data), size_(state.bytes), state_(state) {}
    const std::byte* data_ = nullptr;  // page-aligned
    std::size_t size_ = 0;
    FileState state_{};
};

}  // namespace hapticlod
