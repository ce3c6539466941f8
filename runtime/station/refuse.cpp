#include <cstdio>

#include "station/commands.hpp"

namespace hapticlod::station {

int refuse(const Fault& fault) {
    std::fprintf(stderr, "%s\n", fault.line().c_str());
    return kExitBadInput;
}

}  // namespace hapticlod::station
