#include "station/doctor.hpp"

#include <sys/resource.h>
#include <sys/utsname.h>
#include <time.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "station/realtime.hpp"

namespace hapticlod::station {
namespace {

namespace fs = std::filesystem;

std::string line_of(const std::string& path) {
    std::ifstream file(path);
    std::string line;
    std::getline(file, line);
    return line;
}

Finding kernel(const std::string& root) {
    utsname name{};
    ::uname(&name);
    const std::string version = std::string(name.release) + " " + name.version;
    if (line_of(root + "/sys/kernel/realtime") == "1" || version.find("PREEMPT_RT") != std::string::npos) {
        return {"kernel", Health::good, version, ""};
    }
    return {"kernel", Health::weak, version + ": not PREEMPT_RT, so drivers may delay the loop",
            "install a real-time kernel (Debian: linux-image-rt-amd64)"};
}

Finding virtual_machine(const std::string& root) {
    std::ifstream file(root + "/proc/cpuinfo");
    for (std::string line; std::getline(file, line);) {
        if (line.starts_with("flags") && line.find(" hypervisor") != std::string::npos) {
            return {"machine", Health::weak, "virtual: its host decides when the loop wakes up",
                    "run the station on the machine that the device is plugged into"};
        }
    }
    return {"machine", Health::good, "not virtual", ""};
}

Finding governor(const std::string& root) {
    std::error_code error;
    std::string slow;
    int seen = 0;
    for (const auto& cpu : fs::directory_iterator(root + "/sys/devices/system/cpu", error)) {
        const std::string value = line_of(cpu.path() / "cpufreq/scaling_governor");
        if (value.empty()) continue;
        ++seen;
        if (value != "performance") slow = value;
    }
    if (seen == 0) return {"processor clock", Health::good, "not scaled by this system", ""};
    if (slow.empty()) return {"processor clock", Health::good, "governor performance", ""};
    return {"processor clock", Health::weak, "governor " + slow + ": the clock falls while the loop sleeps",
            "cpupower frequency-set -g performance"};
}

Finding limit(const char* what, int resource, std::uint64_t least, const char* entry) {
    rlimit value{};
    ::getrlimit(static_cast<__rlimit_resource_t>(resource), &value);
    const bool enough = ::geteuid() == 0 || value.rlim_cur == RLIM_INFINITY || value.rlim_cur >= least;
    const std::string found = ::geteuid() == 0                  ? "not limited (root)"
                              : value.rlim_cur == RLIM_INFINITY ? "not limited"
                                                                : "at most " + std::to_string(value.rlim_cur);
    if (enough) return {what, Health::good, found, ""};
    return {what, Health::bad, found,
            std::string("copy configs/devices/hapticlod-limits.conf to /etc/security/limits.d/ (it has '") + entry +
                "'), join the group realtime, log in again"};
}

Finding timer() {
    timespec resolution{};
    ::clock_getres(CLOCK_MONOTONIC, &resolution);
    const long ns = resolution.tv_sec * 1'000'000'000L + resolution.tv_nsec;
    const std::string found = std::to_string(ns) + " ns";
    if (ns <= 1000) return {"timer resolution", Health::good, found, ""};
    return {"timer resolution", Health::bad, found,
            "use a kernel with high-resolution timers (CONFIG_HIGH_RES_TIMERS)"};
}

Finding clocksource(const std::string& root) {
    const std::string source = line_of(root + "/sys/devices/system/clocksource/clocksource0/current_clocksource");
    if (source != "hpet" && source != "acpi_pm" && source != "jiffies") {
        return {"clock source", Health::good, source.empty() ? "not told" : source, ""};
    }
    return {"clock source", Health::weak, source + ": reading the time takes microseconds",
            "boot with tsc=reliable if this processor's time stamp counter is invariant"};
}

Finding isolation(const std::string& root) {
    const std::string isolated = line_of(root + "/sys/devices/system/cpu/isolated");
    if (!isolated.empty()) return {"isolated processor", Health::good, isolated, ""};
    return {"isolated processor", Health::weak, "none: other programs share the loop's",
            "boot with isolcpus=N nohz_full=N for one processor N; the station takes it by itself"};
}

Finding throttling(const std::string& root) {
    const std::string value = line_of(root + "/proc/sys/kernel/sched_rt_runtime_us");
    if (value.empty() || value == "-1") return {"real-time throttling", Health::good, "off", ""};
    return {"real-time throttling", Health::weak, value + " us in a second are left to real-time programs",
            "sysctl kernel.sched_rt_runtime_us=-1, once the loop has its own processor"};
}

Finding shared_memory(const std::string& root) {
    std::error_code error;
    const fs::space_info space = fs::space(root + "/dev/shm", error);
    if (!error && space.available > (64u << 20)) {
        return {"shared memory", Health::good, std::to_string(space.available >> 20) + " MB", ""};
    }
    return {"shared memory", Health::bad, error ? "no /dev/shm" : std::to_string(space.available >> 20) + " MB",
            "mount a tmpfs of 128 MB there: telemetry and the flight recorder need it"};
}

std::vector<Finding> hid_nodes(const std::string& root) {
    std::vector<Finding> findings;
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(root + "/dev", error)) {
        const std::string name = entry.path().filename();
        if (!name.starts_with("hidraw")) continue;
        if (::access(entry.path().c_str(), R_OK | W_OK) == 0) {
            findings.push_back({"/dev/" + name, Health::good, "may be opened", ""});
        } else {
            findings.push_back({"/dev/" + name, Health::weak, "may not be opened by this user",
                                "if it is the force-feedback device: copy configs/devices/70-hapticlod.rules to "
                                "/etc/udev/rules.d/, put its ids in, plug it in again"});
        }
    }
    if (findings.empty()) findings.push_back({"HID devices", Health::weak, "none", "plug the device in"});
    return findings;
}

}  // namespace

std::vector<Finding> diagnose(const std::string& root) {
    std::vector<Finding> findings = {
        kernel(root),
        virtual_machine(root),
        governor(root),
        limit("real-time priority", RLIMIT_RTPRIO, kFifoPriority, "rtprio 90"),
        limit("locked memory", RLIMIT_MEMLOCK, 1u << 30, "memlock unlimited"),
        timer(),
        clocksource(root),
        isolation(root),
        throttling(root),
        shared_memory(root),
    };
    for (Finding& finding : hid_nodes(root)) findings.push_back(std::move(finding));
    return findings;
}

}  // namespace hapticlod::station
