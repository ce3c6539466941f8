#include "station/bundle_trust.hpp"

#include <cstdio>

namespace hapticlod::station {

Result<TrustVerdict> require_trust(const Bundle& bundle, const Arguments& arguments) {
    auto judged = trust_of(bundle.signer(), arguments.option("--trusted-keys"));
    if (!judged) return judged;
    const TrustVerdict& verdict = judged.value();
    if (verdict.trust == Trust::trusted) return judged;
    if (arguments.flag("--accept-unsigned")) {
        std::fprintf(stderr, "%s: %s; run because of --accept-unsigned\n", bundle.path().c_str(),
                     verdict.text().c_str());
        return judged;
    }
    return Fault{bundle.path(), "is " + verdict.text(),
                 verdict.trust == Trust::unsigned_bundle
                     ? "sign it with `hapticlod key sign`, or run it with --accept-unsigned"
                     : "trust its key with `hapticlod key trust`, or run it with --accept-unsigned"};
}

}  // namespace hapticlod::station
