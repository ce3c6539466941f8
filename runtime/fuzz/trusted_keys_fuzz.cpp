// Any text as a file of trusted keys: refused in one line, or entries with a name.
#include <cstdlib>

#include "io/trust.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace hapticlod;
    const auto keys = parse_trusted_keys({reinterpret_cast<const char*>(data), size}, "fuzz");
    if (!keys) {
        if (keys.fault().line().find('\n') != std::string::npos) std::abort();
        return 0;
    }
    for (const TrustedKey& entry : keys.value()) {
        if (entry.name.empty() || public_key_from_base64(base64(entry.key)) != entry.key) std::abort();
        if (judge_trust(entry.key, keys.value(), {}).trust == Trust::unknown_key) std::abort();
    }
    return 0;
}
