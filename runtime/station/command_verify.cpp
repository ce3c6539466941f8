// verify: would this station run the bundle? Everything in it is checked, and whose it is.
#include <cstdio>

#include "station/bundle_trust.hpp"
#include "station/commands.hpp"

namespace hapticlod::station {

int command_verify(Words words) {
    const auto arguments = Arguments::parse(words, {{"BUNDLE"}, {"--trusted-keys"}, {"--accept-unsigned"}});
    if (!arguments) return refuse(arguments.fault());
    const auto bundle = Bundle::open(arguments.value().positional(0));
    if (!bundle) return refuse(bundle.fault());
    const auto trust = require_trust(bundle.value(), arguments.value());
    if (!trust) return refuse(trust.fault());
    std::printf("%s: all checked, %s\n", bundle.value().path().c_str(), trust.value().text().c_str());
    return kExitFine;
}

}  // namespace hapticlod::station
