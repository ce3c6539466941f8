// The calls of hidapi. Left out of static builds: hidapi needs libudev, which is not to be had as a static library.
#include <hidapi.h>

#include <cerrno>
#include <cstring>

#include "station/hid_connection.hpp"

namespace hapticlod::station {
namespace {

std::string narrow(const wchar_t* text) {
    std::string out;
    for (; text != nullptr && *text != 0; ++text) {
        const auto c = static_cast<std::uint32_t>(*text);  // UTF-8
        if (c < 0x80) {
            out += static_cast<char>(c);
        } else if (c < 0x800) {
            out += static_cast<char>(0xC0 | (c >> 6));
            out += static_cast<char>(0x80 | (c & 0x3F));
        } else {
            out += static_cast<char>(0xE0 | ((c >> 12) & 0x0F));
            out += static_cast<char>(0x80 | ((c >> 6) & 0x3F));
            out += static_cast<char>(0x80 | (c & 0x3F));
        }
    }
    return out;
}

}  // namespace

std::vector<HidEntry> list_hid() {
    std::vector<HidEntry> entries;
    hid_device_info* list = hid_enumerate(0, 0);
    for (const hid_device_info* info = list; info != nullptr; info = info->next) {
        entries.push_back({info->path, info->vendor_id, info->product_id, info->usage_page, info->usage,
                           info->interface_number, narrow(info->manufacturer_string), narrow(info->product_string),
                           narrow(info->serial_number)});
    }
    hid_free_enumeration(list);
    return entries;
}

void HidConnection::Close::operator()(hid_device_* handle) const noexcept { hid_close(handle); }

Result<HidConnection> HidConnection::open(const std::string& path) {
    errno = 0;
    hid_device* handle = hid_open_path(path.c_str());
    const int error = errno;
    if (handle != nullptr) return HidConnection(handle);
    if (error == EACCES || error == EPERM) {
        return Fault{path, "may not be opened (permission denied)",
                     "install the udev rule of docs/devices.md and plug the device in again, or run as root"};
    }
    const std::string reason = error != 0 ? std::strerror(error) : narrow(hid_error(nullptr));
    return Fault{path, "cannot be opened (" + reason + ")", "plug the device in again; hapticlod-station doctor"};
}

int HidConnection::read(std::span<std::uint8_t> report) noexcept {
    return hid_read_timeout(handle_.get(), report.data(), report.size(), 0);
}

int HidConnection::write(std::span<const std::uint8_t> report) noexcept {
    return hid_write(handle_.get(), report.data(), report.size());
}

}  // namespace hapticlod::station
