// JSON as text: a writer for the one-line results of the station, and a check that a manifest really is JSON.
#pragma once
#include <cstdint>
#include <string>
#include <string_view>

namespace hapticlod {

// Writes one JSON value piece by piece; commas are its own business. Numbers are shortest-round-trip; a number that
// is not finite becomes null, as JSON has no word for it.
class JsonWriter {
public:
    JsonWriter& open(char bracket);  // '{' or '['
    JsonWriter& close();
    JsonWriter& key(std::string_view name);
    JsonWriter& value(std::string_view text);
    JsonWriter& value(const char* text) { return value(std::string_view(text)); }
    JsonWriter& value(bool flag);
    JsonWriter& value(double number);
    JsonWriter& value(std::uint64_t number);
    JsonWriter& value(std::uint32_t number) { return value(std::uint64_t{number}); }
    JsonWriter& raw(std::string_view json);  // a value that already is JSON

    template <class T>
    JsonWriter& field(std::string_view name, T content) {
        return key(name).value(content);
    }

    // The text so far; complete when every bracket is closed.
    [[nodiscard]] const std::string& text() const { return text_; }

private:
    void separate();
    std::string text_;
    std::string brackets_;
    bool first_ = true;
};

// Whether the text is one JSON object (RFC 8259, valid UTF-8, at most 64 levels deep) and nothing else.
[[nodiscard]] bool is_json_object(std::string_view text);

}  // namespace hapticlod
