#include "station/hid_connection.hpp"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>

namespace hapticlod::station {
namespace {

std::string ids(const DeviceMatch& match) {
    char text[16];
    std::snprintf(text, sizeof(text), "%04x:%04x", match.vendor_id, match.product_id);
    return text;
}

// Another program that has the node open: "name (pid 123)"; empty where none is seen.
std::string holder_of(const std::string& path) {
    namespace fs = std::filesystem;
    std::error_code error;
    for (const fs::directory_entry& process : fs::directory_iterator("/proc", error)) {
        const std::string pid = process.path().filename();
        if (pid.find_first_not_of("0123456789") != std::string::npos || pid == std::to_string(::getpid())) continue;
        std::error_code ignored;
        for (const fs::directory_entry& open : fs::directory_iterator(process.path() / "fd", ignored)) {
            std::error_code unread;
            if (fs::read_symlink(open.path(), unread) != path) continue;
            std::string name;
            std::ifstream(process.path() / "comm") >> name;
            return name + " (pid " + pid + ")";
        }
    }
    return "";
}

}  // namespace

bool matches(const HidEntry& entry, const DeviceMatch& match) {
    return entry.vendor_id == match.vendor_id && entry.product_id == match.product_id &&
           (!match.usage_page || entry.usage_page == *match.usage_page) &&
           (!match.usage || entry.usage == *match.usage) &&
           (match.product.empty() || entry.product.find(match.product) != std::string::npos) &&
           (match.serial.empty() || entry.serial == match.serial);
}

Result<HidEntry> find_device(const DeviceProfile& profile, const std::string& path, const std::string& serial) {
    std::vector<HidEntry> found;
    for (HidEntry& entry : list_hid()) {
        if (!matches(entry, profile.match)) continue;
        if (!path.empty() && entry.path != path) continue;
        if (!serial.empty() && entry.serial != serial) continue;
        const bool listed = std::any_of(found.begin(), found.end(),
                                        [&entry](const HidEntry& other) { return other.path == entry.path; });
        if (!listed) found.push_back(std::move(entry));
    }
    if (found.empty()) {
        const std::string which =
            (path.empty() ? "" : " at " + path) + (serial.empty() ? "" : " with serial " + serial);
        return Fault{profile.file, "no device " + ids(profile.match) + " (" + profile.name + ")" + which + " is there",
                     "plug it in; hapticlod-station devices lists what is"};
    }
    if (found.size() > 1) {
        std::string list;
        for (const HidEntry& entry : found) {
            list += (list.empty() ? "" : ", ") + entry.path + (entry.serial.empty() ? "" : " serial " + entry.serial);
        }
        return Fault{profile.file, std::to_string(found.size()) + " devices match (" + list + ")",
                     "choose one with --serial or --path"};
    }
    return std::move(found.front());
}

Result<DeviceClaim> DeviceClaim::take(const std::string& path) {
    // An abstract socket address is a name that only one process can hold and that leaves no file behind.
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const std::string name = "hapticlod-device:" + path;
    const std::size_t length = std::min(name.size(), sizeof(address.sun_path) - 1);
    std::memcpy(address.sun_path + 1, name.data() + (name.size() - length), length);
    const int socket = ::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + 1 + length);
    if (socket < 0) return Fault{path, "cannot be claimed", "close other programs"};
    if (::bind(socket, reinterpret_cast<const sockaddr*>(&address), size) != 0) {
        ::close(socket);
        return Fault{path, "is in use by another hapticlod-station", "stop it first"};
    }
    if (const std::string holder = holder_of(path); !holder.empty()) {
        ::close(socket);
        return Fault{path, "is in use by " + holder, "stop that program first: two of them would both send forces"};
    }
    return DeviceClaim(socket);
}

DeviceClaim::~DeviceClaim() {
    if (socket_ >= 0) ::close(socket_);
}

}  // namespace hapticlod::station
