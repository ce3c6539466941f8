// A station without HID: no device is listed and none opens. For static builds, in place of hid_api.cpp.
#include "station/hid_connection.hpp"

namespace hapticlod::station {

std::vector<HidEntry> list_hid() { return {}; }

void HidConnection::Close::operator()(hid_device_*) const noexcept {}

Result<HidConnection> HidConnection::open(const std::string& path) {
    return Fault{path, "cannot be opened: this station was built without HID", "use the station that is not static"};
}

int HidConnection::read(std::span<std::uint8_t>) noexcept { return -1; }
int HidConnection::write(std::span<const std::uint8_t>) noexcept { return -1; }

}  // namespace hapticlod::station
