// toml++ 3.3 has undefined behaviour on a letter beyond ASCII that stands outside of strings and comments
// (`name =é1`): its question whether the letter is a blank ends in an unreachable point. Above U+FEFF the question is
// answered at once. So letters are raised there, one for one, before it sees them, and lowered in what it gives back.
#pragma once
#include <string>
#include <string_view>

#include "io/result.hpp"

namespace hapticlod::station {

// U+0080 to U+FFFF become U+100080 to U+10FFFF; all else stays, so lines and columns do, too. A byte order mark at the
// front is left out. Faults name file:line:column: text that is not UTF-8, or has letters that are up there already
// (plane 16, private use).
[[nodiscard]] Result<std::string> raised_letters(std::string_view text, const std::string& name);

// The way back, for UTF-8 that came out of raised_letters().
[[nodiscard]] std::string lowered_letters(std::string_view text);

}  // namespace hapticlod::station
