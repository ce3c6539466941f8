// Writes MCAP, the recording format of robotics (https://mcap.dev/spec): readable by Foxglove and the `mcap` packages.
// Indexed, uncompressed chunks with checksums; one schema, one channel, JSON messages. A file that was never closed
// still reads up to its last whole chunk.
#pragma once
#include <cstdint>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "io/result.hpp"

namespace hapticlod::station {

[[nodiscard]] std::uint32_t crc32_ieee(std::string_view bytes);

class McapWriter {
public:
    struct Channel {
        std::string topic, schema_name, json_schema;
    };

    // Written beside as `path`.part; close() gives it its name.
    [[nodiscard]] static Result<McapWriter> create(const std::string& path, const Channel& channel);
    // Times never decrease.
    void write(std::uint64_t time_ns, std::string_view json);
    // Index, statistics, end; the fault says what could not be written, now or before.
    [[nodiscard]] std::optional<Fault> close();
    [[nodiscard]] const std::string& path() const { return path_; }
    [[nodiscard]] std::uint64_t messages() const { return messages_; }

private:
    struct Chunk {  // what its index says
        std::uint64_t first_ns, last_ns, start, length, index_start, index_length, size;
    };
    struct CloseFile {
        void operator()(std::FILE* file) const noexcept { std::fclose(file); }
    };
    McapWriter(std::string path, std::FILE* file) : path_(std::move(path)), file_(file) {}
    void put(std::string_view bytes);
    void finish_chunk();

    std::string path_;
    std::unique_ptr<std::FILE, CloseFile> file_;
    std::string definitions_;  // schema and channel records, written twice
    std::size_t schema_bytes_ = 0;
    std::string chunk_;        // message records
    std::string chunk_index_;  // (time, offset) pairs
    std::uint64_t chunk_first_ns_ = 0, last_ns_ = 0, first_ns_ = 0;
    std::uint64_t at_ = 0;  // bytes in the file
    std::uint64_t messages_ = 0;
    std::vector<Chunk> chunks_;
    bool failed_ = false;
};

}  // namespace hapticlod::station
