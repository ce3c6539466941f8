#include "io/json_text.hpp"

#include <array>
#include <charconv>
#include <cmath>

namespace hapticlod {

void JsonWriter::separate() {
    if (!first_) text_ += ',';
    first_ = false;
}

JsonWriter& JsonWriter::open(char bracket) {
    separate();
    text_ += bracket;
    brackets_ += bracket == '{' ? '}' : ']';
    first_ = true;
    return *this;
}

JsonWriter& JsonWriter::close() {
    text_ += brackets_.back();
    brackets_.pop_back();
    first_ = false;
    return *this;
}

JsonWriter& JsonWriter::key(std::string_view name) {
    value(name);
    text_ += ':';
    first_ = true;  // no comma between a key and its value
    return *this;
}

JsonWriter& JsonWriter::value(std::string_view text) {
    separate();
    text_ += '"';
    for (const char letter : text) {
        const auto code = static_cast<unsigned char>(letter);
        if (letter == '"' || letter == '\\') {
            text_ += '\\';
            text_ += letter;
        } else if (code < 0x20) {
            constexpr std::string_view hex = "0123456789abcdef";
            text_ += "\\u00";
            text_ += hex[code >> 4];
            text_ += hex[code & 15];
        } else {
            text_ += letter;
        }
    }
    text_ += '"';
    return *this;
}

JsonWriter& JsonWriter::value(bool flag) { return raw(flag ? "true" : "false"); }

JsonWriter& JsonWriter::value(double number) {
    if (!std::isfinite(number)) return raw("null");
    std::array<char, 32> digits;
    const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr;
    return raw({digits.data(), static_cast<std::size_t>(end - digits.data())});
}

JsonWriter& JsonWriter::value(std::uint64_t number) { return raw(std::to_string(number)); }

JsonWriter& JsonWriter::raw(std::string_view json) {
    separate();
    text_ += json;
    return *this;
}

namespace {

// Recursive descent with a depth limit, so that a hostile file cannot exhaust the stack.
class Checker {
public:
    explicit Checker(std::string_view text) : text_(text) {}

    bool object_only() {
        space();
        if (peek() != '{' || !value(0)) return false;
        space();
        return at_ == text_.size();
    }

private:
    static constexpr int kMaxDepth = 64;

    [[nodiscard]] int peek() const { return at_ < text_.size() ? static_cast<unsigned char>(text_[at_]) : -1; }
    bool take(char letter) {
        if (peek() != letter) return false;
        ++at_;
        return true;
    }
    void space() {
        while (peek() == ' ' || peek() == '\t' || peek() == '\n' || peek() == '\r') ++at_;
    }
    bool word(std::string_view expected) {
        if (text_.substr(at_, expected.size()) != expected) return false;
        at_ += expected.size();
        return true;
    }
    bool digits() {
        const std::size_t start = at_;
        while (peek() >= '0' && peek() <= '9') ++at_;
        return at_ > start;
    }
    bool number() {
        take('-');
        if (!take('0') && !digits()) return false;
        if (take('.') && !digits()) return false;
        if (take('e') || take('E')) {
            if (!take('+')) take('-');
            return digits();
        }
        return true;
    }
    // One character of more than one byte: shortest form, no surrogates, at most U+10FFFF.
    bool multibyte() {
        const int lead = peek();
        const int more = lead >= 0xf0 ? 3 : lead >= 0xe0 ? 2 : 1;
        if (lead < 0xc2 || lead > 0xf4) return false;
        ++at_;
        for (int i = 0; i < more; ++i, ++at_) {
            const int next = peek();
            if (next < 0x80 || next > 0xbf) return false;
            if (i == 0 && ((lead == 0xe0 && next < 0xa0) || (lead == 0xed && next > 0x9f) ||
                           (lead == 0xf0 && next < 0x90) || (lead == 0xf4 && next > 0x8f))) {
                return false;
            }
        }
        return true;
    }
    bool escape() {
        const int letter = peek();
        ++at_;
        if (letter != 'u') return letter > 0 && std::string_view("\"\\/bfnrt").find(static_cast<char>(letter)) < 8;
        for (int i = 0; i < 4; ++i, ++at_) {
            const int digit = peek();
            if (digit < 0 || std::string_view("0123456789abcdefABCDEF").find(static_cast<char>(digit)) > 21) {
                return false;
            }
        }
        return true;
    }
    bool string() {
        if (!take('"')) return false;
        while (!take('"')) {
            if (take('\\')) {
                if (!escape()) return false;
            } else if (peek() >= 0x80) {
                if (!multibyte()) return false;
            } else if (peek() < 0x20) {
                return false;
            } else {
                ++at_;
            }
        }
        return true;
    }
    bool members(char close, int depth) {
        space();
        if (take(close)) return true;
        do {
            space();
            if (close == '}') {
                if (!string()) return false;
                space();
                if (!take(':')) return false;
            }
            if (!value(depth + 1)) return false;
            space();
        } while (take(','));
        return take(close);
    }
    bool value(int depth) {
        space();
        if ((peek() == '{' || peek() == '[') && depth >= kMaxDepth) return false;
        if (take('{')) return members('}', depth);
        if (take('[')) return members(']', depth);
        if (peek() == '"') return string();
        if (peek() == 't') return word("true");
        if (peek() == 'f') return word("false");
        if (peek() == 'n') return word("null");
        return number();
    }

    std::string_view text_;
    std::size_t at_ = 0;
};

}  // namespace

bool is_json_object(std::string_view text) { return Checker(text).object_only(); }

}  // namespace hapticlod
