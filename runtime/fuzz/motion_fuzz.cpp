// Any text as a motion: refused in one line, or sampled to finite unit quaternions.
#include <cmath>
#include <cstdlib>

#include "io/motion_csv.hpp"
#include "io/motion_interpolation.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace hapticlod;
    const auto motion = parse_motion_csv({reinterpret_cast<const char*>(data), size}, "fuzz.csv");
    if (!motion) {
        if (motion.fault().line().find('\n') != std::string::npos) std::abort();
        return 0;
    }
    const std::vector<MotionRow>& rows = motion.value();
    if (!check_motion(rows).empty()) std::abort();
    const double first_s = rows.front().time_s, last_s = rows.back().time_s;
    for (const double time_s : {first_s - 1.0, first_s, 0.5 * (first_s + last_s), last_s, last_s + 1.0}) {
        const MotionSample sample = sample_motion(rows, time_s);
        for (const double part : sample.orientation) {
            if (!(std::abs(part) <= 1.0 + 1e-9)) std::abort();
        }
    }
    if (last_s - first_s < 1.0) static_cast<void>(resample_motion(rows, 100.0));
    return 0;
}
