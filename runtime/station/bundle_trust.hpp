// Whether this station may run a bundle: signed by a key that it trusts, or let through by an explicit flag.
#pragma once
#include "io/bundle.hpp"
#include "io/trust.hpp"
#include "station/arguments.hpp"

namespace hapticlod::station {

// `--trusted-keys FILE` replaces the standard files; `--accept-unsigned` also takes bundles that are unsigned or signed
// by a key that is not trusted (any more), and says so on stderr. A wrong signature never gets as far as here.
// Commands that render for a hand list both words in their ArgumentRules and call this after opening the bundle.
[[nodiscard]] Result<TrustVerdict> require_trust(const Bundle& bundle, const Arguments& arguments);

}  // namespace hapticlod::station
