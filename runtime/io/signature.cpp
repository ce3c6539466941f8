#include "io/signature.hpp"

#include <sodium.h>

namespace hapticlod {
namespace {

bool sodium_ready() {
    static const bool ready = sodium_init() >= 0;
    return ready;
}

}  // namespace

bool verify_signature(const SignatureData& data, std::span<const std::byte> header_and_table) {
    return sodium_ready() && crypto_sign_ed25519_verify_detached(
                                 data.signature.data(), reinterpret_cast<const unsigned char*>(header_and_table.data()),
                                 header_and_table.size(), data.public_key.data()) == 0;
}

std::string base64(const PublicKey& key) {
    char text[sodium_base64_ENCODED_LEN(sizeof(PublicKey), sodium_base64_VARIANT_ORIGINAL)];
    return sodium_bin2base64(text, sizeof(text), key.data(), key.size(), sodium_base64_VARIANT_ORIGINAL);
}

std::optional<PublicKey> public_key_from_base64(std::string_view text) {
    PublicKey key{};
    std::size_t length = 0;
    const char* end = nullptr;
    if (sodium_base642bin(key.data(), key.size(), text.data(), text.size(), nullptr, &length, &end,
                          sodium_base64_VARIANT_ORIGINAL) != 0 ||
        length != key.size() || end != text.data() + text.size()) {
        return std::nullopt;
    }
    return key;
}

}  // namespace hapticlod
