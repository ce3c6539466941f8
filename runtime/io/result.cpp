#include "io/result.hpp"

namespace hapticlod {

std::string Fault::line() const {
    std::string text = where + ": " + what + "; " + remedy;
    for (char& letter : text) {
        if (static_cast<unsigned char>(letter) < 0x20) letter = ' ';
    }
    return text;
}

}  // namespace hapticlod
