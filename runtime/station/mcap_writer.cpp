#include "station/mcap_writer.hpp"

#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>

namespace hapticlod::station {
namespace {

constexpr std::string_view kMagic("\x89MCAP0\r\n", 8);
constexpr std::size_t kChunkBytes = 1 << 18;
constexpr std::uint16_t kSchema = 1, kChannel = 1;

enum Opcode : std::uint8_t {
    kHeader = 0x01,
    kFooter = 0x02,
    kSchemaRecord = 0x03,
    kChannelRecord = 0x04,
    kMessage = 0x05,
    kChunk = 0x06,
    kMessageIndex = 0x07,
    kChunkIndex = 0x08,
    kStatistics = 0x0B,
    kSummaryOffset = 0x0E,
    kDataEnd = 0x0F
};

constexpr auto kCrcTable = [] {
    std::array<std::uint32_t, 256> table{};
    for (std::uint32_t i = 0; i < 256; ++i) {
        std::uint32_t value = i;
        for (int bit = 0; bit < 8; ++bit) value = (value & 1) != 0 ? (value >> 1) ^ 0xEDB88320u : value >> 1;
        table[i] = value;
    }
    return table;
}();

// Little-endian, as everything in MCAP.
template <class T>
void add(std::string& out, T value) {
    for (std::size_t i = 0; i < sizeof(T); ++i) out += static_cast<char>(static_cast<std::uint64_t>(value) >> (8 * i));
}

void add_text(std::string& out, std::string_view text) {
    add(out, static_cast<std::uint32_t>(text.size()));
    out += text;
}

std::string record(Opcode opcode, std::string_view content) {
    std::string out(1, static_cast<char>(opcode));
    add(out, static_cast<std::uint64_t>(content.size()));
    return out.append(content);
}

std::string schema_record(const McapWriter::Channel& channel) {
    std::string content;
    add(content, kSchema);
    add_text(content, channel.schema_name);
    add_text(content, "jsonschema");
    add_text(content, channel.json_schema);
    return record(kSchemaRecord, content);
}

std::string channel_record(const McapWriter::Channel& channel) {
    std::string content;
    add(content, kChannel);
    add(content, kSchema);
    add_text(content, channel.topic);
    add_text(content, "json");
    add(content, std::uint32_t{0});  // metadata
    return record(kChannelRecord, content);
}

}  // namespace

std::uint32_t crc32_ieee(std::string_view bytes) {
    std::uint32_t crc = 0xFFFFFFFFu;
    for (const char c : bytes) crc = kCrcTable[(crc ^ static_cast<std::uint8_t>(c)) & 0xFF] ^ (crc >> 8);
    return ~crc;
}

Result<McapWriter> McapWriter::create(const std::string& path, const Channel& channel) {
    std::FILE* file = std::fopen((path + ".part").c_str(), "wbe");
    if (file == nullptr) {
        return Fault{path, std::string("cannot be written (") + std::strerror(errno) + ")",
                     "choose a folder that exists and is writable"};
    }
    McapWriter writer(path, file);
    std::string header;
    add_text(header, "");
    add_text(header, "hapticlod-station");
    const std::string schema = schema_record(channel);
    writer.schema_bytes_ = schema.size();
    writer.definitions_ = schema + channel_record(channel);
    writer.put(kMagic);
    writer.put(record(kHeader, header));
    writer.put(writer.definitions_);
    return writer;
}

void McapWriter::put(std::string_view bytes) {
    failed_ = failed_ || std::fwrite(bytes.data(), 1, bytes.size(), file_.get()) != bytes.size();
    at_ += bytes.size();
}

void McapWriter::write(std::uint64_t time_ns, std::string_view json) {
    if (messages_ == 0) first_ns_ = time_ns;
    if (chunk_.empty()) chunk_first_ns_ = time_ns;
    last_ns_ = time_ns;
    add(chunk_index_, time_ns);
    add(chunk_index_, static_cast<std::uint64_t>(chunk_.size()));
    std::string content;
    add(content, kChannel);
    add(content, static_cast<std::uint32_t>(messages_++));
    add(content, time_ns);  // logged
    add(content, time_ns);  // published
    content += json;
    chunk_ += record(kMessage, content);
    if (chunk_.size() >= kChunkBytes) finish_chunk();
}

void McapWriter::finish_chunk() {
    if (chunk_.empty()) return;
    std::string content;
    add(content, chunk_first_ns_);
    add(content, last_ns_);
    add(content, static_cast<std::uint64_t>(chunk_.size()));
    add(content, crc32_ieee(chunk_));
    add_text(content, "");  // no compression
    add(content, static_cast<std::uint64_t>(chunk_.size()));
    content += chunk_;
    Chunk made{chunk_first_ns_, last_ns_, at_, 0, 0, 0, chunk_.size()};
    put(record(kChunk, content));
    made.length = at_ - made.start;
    made.index_start = at_;
    std::string index;
    add(index, kChannel);
    add_text(index, chunk_index_);
    put(record(kMessageIndex, index));
    made.index_length = at_ - made.index_start;
    chunks_.push_back(made);
    chunk_.clear();
    chunk_index_.clear();
    failed_ = failed_ || std::fflush(file_.get()) != 0;
}

std::optional<Fault> McapWriter::close() {
    finish_chunk();
    put(record(kDataEnd, std::string(4, '\0')));  // no checksum of the data section
    const std::uint64_t summary = at_;
    std::string closing = definitions_;
    const std::uint64_t statistics_at = summary + closing.size();
    std::string content;
    add(content, messages_);
    add(content, std::uint16_t{1});  // schemas
    add(content, std::uint32_t{1});  // channels
    add(content, std::uint32_t{0});  // attachments
    add(content, std::uint32_t{0});  // metadata
    add(content, static_cast<std::uint32_t>(chunks_.size()));
    add(content, messages_ == 0 ? 0 : first_ns_);
    add(content, last_ns_);
    add(content, std::uint32_t{10});  // bytes of the map: channel -> messages
    add(content, kChannel);
    add(content, messages_);
    closing += record(kStatistics, content);
    const std::uint64_t chunks_at = summary + closing.size();
    for (const Chunk& chunk : chunks_) {
        content.clear();
        for (const std::uint64_t value : {chunk.first_ns, chunk.last_ns, chunk.start, chunk.length})
            add(content, value);
        add(content, std::uint32_t{10});  // bytes of the map: channel -> its message index
        add(content, kChannel);
        add(content, chunk.index_start);
        add(content, chunk.index_length);
        add_text(content, "");
        add(content, chunk.size);
        add(content, chunk.size);
        closing += record(kChunkIndex, content);
    }
    const std::uint64_t offsets_at = summary + closing.size();
    const auto group = [&closing](Opcode opcode, std::uint64_t start, std::uint64_t end) {
        if (end == start) return;
        std::string offset(1, static_cast<char>(opcode));
        add(offset, start);
        add(offset, end - start);
        closing += record(kSummaryOffset, offset);
    };
    group(kSchemaRecord, summary, summary + schema_bytes_);
    group(kChannelRecord, summary + schema_bytes_, statistics_at);
    group(kStatistics, statistics_at, chunks_at);
    group(kChunkIndex, chunks_at, offsets_at);
    // The footer's checksum covers the summary and the footer up to the checksum itself.
    closing += static_cast<char>(kFooter);
    add(closing, std::uint64_t{20});
    add(closing, summary);
    add(closing, offsets_at);
    add(closing, crc32_ieee(closing));
    put(closing);
    put(kMagic);
    failed_ = failed_ || std::fflush(file_.get()) != 0 || ::fsync(::fileno(file_.get())) != 0;
    file_.reset();
    if (!failed_ && std::rename((path_ + ".part").c_str(), path_.c_str()) == 0) return std::nullopt;
    return Fault{path_, std::string("could not be written whole (") + std::strerror(errno) + ")",
                 "make room; what there is lies in " + path_ + ".part"};
}

}  // namespace hapticlod::station
