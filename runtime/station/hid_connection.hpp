// HID devices by hidapi (hidraw). hid_api.cpp is the only file that sees it.
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "io/result.hpp"
#include "station/device_profile.hpp"

struct hid_device_;

namespace hapticlod::station {

struct HidEntry {
    std::string path;  // /dev/hidraw3
    std::uint16_t vendor_id = 0, product_id = 0, usage_page = 0, usage = 0;
    int interface_number = -1;
    std::string manufacturer, product, serial;
};

// Every HID device the system lists, once per top-level usage; opens none.
[[nodiscard]] std::vector<HidEntry> list_hid();
[[nodiscard]] bool matches(const HidEntry& entry, const DeviceMatch& match);
// The one that a profile is for. No device and two devices are faults that say what to do.
[[nodiscard]] Result<HidEntry> find_device(const DeviceProfile& profile, const std::string& path,
                                           const std::string& serial);

// One open handle. One thread at a time: hidapi frees an error text in every call, so reader and writer have their own.
class HidConnection {
public:
    [[nodiscard]] static Result<HidConnection> open(const std::string& path);
    // Bytes of the next report in the queue, 0 where it is empty, -1 where the device is gone. Does not wait.
    [[nodiscard]] int read(std::span<std::uint8_t> report) noexcept;
    // Blocks while the device does not take it, for seconds if it must. -1 where the device is gone.
    [[nodiscard]] int write(std::span<const std::uint8_t> report) noexcept;

private:
    struct Close {
        void operator()(hid_device_* handle) const noexcept;
    };
    explicit HidConnection(hid_device_* handle) : handle_(handle) {}
    std::unique_ptr<hid_device_, Close> handle_;
};

// One station per device: held as long as this lives, and let go by the kernel if the process dies.
class DeviceClaim {
public:
    [[nodiscard]] static Result<DeviceClaim> take(const std::string& path);
    DeviceClaim(DeviceClaim&& other) noexcept : socket_(std::exchange(other.socket_, -1)) {}
    DeviceClaim& operator=(DeviceClaim&& other) noexcept {
        std::swap(socket_, other.socket_);
        return *this;
    }
    ~DeviceClaim();

private:
    explicit DeviceClaim(int socket) : socket_(socket) {}
    int socket_;
};

}  // namespace hapticlod::station
