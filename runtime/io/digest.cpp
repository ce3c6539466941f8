#include "io/digest.hpp"

#include <sodium.h>

namespace hapticlod {

Digest blake2b_256(std::span<const std::byte> bytes) {
    Digest digest{};
    // sodium_init picks the fastest code for this machine; it may be called often and from several threads.
    static const int ready = sodium_init();
    (void)ready;
    crypto_generichash(digest.data(), digest.size(), reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(),
                       nullptr, 0);
    return digest;
}

std::string hex(const Digest& digest) {
    std::string text;
    for (const std::uint8_t byte : digest) {
        text += "0123456789abcdef"[byte >> 4];
        text += "0123456789abcdef"[byte & 15];
    }
    return text;
}

}  // namespace hapticlod
