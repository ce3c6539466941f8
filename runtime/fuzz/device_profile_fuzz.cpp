// Any text as a device profile: refused in one line, or a profile with a name and limits that are numbers.
#include <cmath>
#include <cstdlib>

#include "station/device_profile.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace hapticlod::station;
    const auto profile = parse_device_profile({reinterpret_cast<const char*>(data), size}, "fuzz.toml");
    if (!profile) {
        if (profile.fault().line().find('\n') != std::string::npos) std::abort();
        return 0;
    }
    if (profile.value().name.empty() || !std::isfinite(profile.value().limits.max_force_n)) std::abort();
    static_cast<void>(profile.value().stability_limit_n_mm(0.0, 1e-3));
    return 0;
}
