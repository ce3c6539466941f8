// Whose bundles a station takes: public keys, one per line, in files that nobody else can write.
//
//     ed25519 BASE64-OF-32-BYTES name [until=YYYY-MM-DD]
//
// Blank lines and lines that start with # are skipped. `until` is the last day (UTC) on which the key is trusted.
#pragma once
#include <chrono>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "io/result.hpp"
#include "io/signature.hpp"

namespace hapticlod {

struct TrustedKey {
    PublicKey key;
    std::string name;
    std::optional<std::chrono::sys_days> until;
};

// Faults name the line.
[[nodiscard]] Result<std::vector<TrustedKey>> parse_trusted_keys(std::string_view text, const std::string& name);

// Refuses a file that its group or everybody can write: whoever can add a key decides what is trusted.
[[nodiscard]] Result<std::vector<TrustedKey>> read_trusted_keys(const std::string& path);

// /etc/hapticlod/trusted_keys and the user's own ($HAPTICLOD_CONFIG, else $XDG_CONFIG_HOME/hapticlod, else
// ~/.config/hapticlod), as far as they exist.
[[nodiscard]] std::vector<std::string> standard_trust_files();

enum class Trust { trusted, unsigned_bundle, unknown_key, expired };

struct TrustVerdict {
    Trust trust = Trust::unsigned_bundle;
    std::string signer;  // the key's name where it is listed, else the key in base64; empty for an unsigned bundle

    // "signed by alice (trusted)", "not signed", ...
    [[nodiscard]] std::string text() const;
};

// A key that is listed several times is trusted where one entry is.
[[nodiscard]] TrustVerdict judge_trust(const std::optional<PublicKey>& signer, const std::vector<TrustedKey>& keys,
                                       std::chrono::sys_days today);

// The same, today, by the keys of one file or else of the standard files.
[[nodiscard]] Result<TrustVerdict> trust_of(const std::optional<PublicKey>& signer,
                                            const std::optional<std::string>& trusted_keys_path);

}  // namespace hapticlod
