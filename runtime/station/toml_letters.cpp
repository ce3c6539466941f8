#include "station/toml_letters.hpp"

#include <cstdint>

namespace hapticlod::station {
namespace {

constexpr char32_t kRaise = 0x100000;
constexpr char32_t kNone = 0xffffffff;

// The letter at the front of UTF-8 text, and its bytes; kNone where it is no UTF-8 (RFC 3629).
char32_t letter_at(std::string_view text, std::size_t& bytes) {
    const auto byte = [text](std::size_t i) { return static_cast<unsigned char>(text[i]); };
    const unsigned char lead = byte(0);
    bytes = lead < 0x80 ? 1 : lead < 0xe0 ? 2 : lead < 0xf0 ? 3 : 4;
    if (bytes == 1) return lead;
    if (lead < 0xc2 || lead > 0xf4 || text.size() < bytes) return kNone;
    char32_t letter = lead & (0x7fu >> bytes);
    for (std::size_t i = 1; i < bytes; ++i) {
        if ((byte(i) & 0xc0) != 0x80) return kNone;
        letter = letter << 6 | (byte(i) & 0x3fu);
    }
    const bool overlong = (bytes == 3 && letter < 0x800) || (bytes == 4 && letter < 0x10000);
    const bool surrogate = letter >= 0xd800 && letter <= 0xdfff;
    return overlong || surrogate || letter > 0x10ffff ? kNone : letter;
}

void append(std::string& text, char32_t letter) {
    const auto put = [&text](char32_t byte) { text += static_cast<char>(static_cast<unsigned char>(byte)); };
    if (letter < 0x80) return put(letter);
    if (letter < 0x800) {
        put(0xc0 | letter >> 6);
    } else {
        if (letter < 0x10000) {
            put(0xe0 | letter >> 12);
        } else {
            put(0xf0 | letter >> 18);
            put(0x80 | (letter >> 12 & 0x3f));
        }
        put(0x80 | (letter >> 6 & 0x3f));
    }
    put(0x80 | (letter & 0x3f));
}

}  // namespace

Result<std::string> raised_letters(std::string_view text, const std::string& name) {
    if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);
    std::string raised;
    raised.reserve(text.size());
    std::size_t line = 1, column = 1, bytes = 0;
    for (; !text.empty(); text.remove_prefix(bytes)) {
        const char32_t letter = letter_at(text, bytes);
        if (letter == kNone || letter >= kRaise) {
            return Fault{
                name + ":" + std::to_string(line) + ":" + std::to_string(column),
                letter == kNone ? "not TOML: is not UTF-8" : "holds a letter of plane 16, which is private use",
                letter == kNone ? "save the file as UTF-8" : "leave it out"};
        }
        append(raised, letter >= 0x80 && letter <= 0xffff ? kRaise + letter : letter);
        column = letter == '\n' ? 1 : column + 1;
        line += letter == '\n';
    }
    return raised;
}

std::string lowered_letters(std::string_view text) {
    std::string lowered;
    lowered.reserve(text.size());
    for (std::size_t bytes = 0; !text.empty(); text.remove_prefix(bytes)) {
        const char32_t letter = letter_at(text, bytes);
        if (letter == kNone) {  // a message that was cut within a letter
            lowered += '?';
            bytes = 1;
        } else {
            append(lowered, letter >= kRaise ? letter - kRaise : letter);
        }
    }
    return lowered;
}

}  // namespace hapticlod::station
