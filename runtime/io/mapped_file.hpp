// A file mapped read-only. The mapping outlives the name: a bundle that is replaced by rename stays readable.
#pragma once
#include <cstddef>
#include <span>
#include <string>

#include "io/result.hpp"

namespace hapticlod {

class MappedFile {
public:
    [[nodiscard]] static Result<MappedFile> open(const std::string& path);
    MappedFile(MappedFile&& other) noexcept;
    MappedFile& operator=(MappedFile&& other) noexcept;
    ~MappedFile();

    [[nodiscard]] std::span<const std::byte> bytes() const { return {data_, size_}; }

private:
    MappedFile(const std::byte* data, std::size_t size) : data_(data), size_(size) {}
    const std::byte* data_ = nullptr;  // page-aligned
    std::size_t size_ = 0;
};

}  // namespace hapticlod
