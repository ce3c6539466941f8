// Ed25519 over a bundle's header and section table. The table holds the digest of every other section, so the signature
// vouches for the whole file.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace hapticlod {

using PublicKey = std::array<std::uint8_t, 32>;

// The content of section SIGNATURE, version 1.
struct SignatureData {
    PublicKey public_key;
    std::array<std::uint8_t, 64> signature;  // of header and table, as they are in the file
};
static_assert(sizeof(SignatureData) == 96);

// Whether the owner of `data.public_key` signed these bytes. Whom that key belongs to is another question:
// io/trust.hpp.
[[nodiscard]] bool verify_signature(const SignatureData& data, std::span<const std::byte> header_and_table);

// 44 characters; how people see a key, and how files of trusted keys hold it.
[[nodiscard]] std::string base64(const PublicKey& key);
[[nodiscard]] std::optional<PublicKey> public_key_from_base64(std::string_view text);

}  // namespace hapticlod
