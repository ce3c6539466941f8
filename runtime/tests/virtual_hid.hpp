// A virtual force-feedback device that speaks the native report (docs/devices.md), behind hidshim: the code under test
// talks to it through the real hidapi. Driven by the test, tick by tick, in simulated time: nothing here has a
// deadline.
#pragma once
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "station/crc16.hpp"

namespace hapticlod::test {

using Report = std::vector<std::uint8_t>;

// The folder that hidshim looks into, for as long as it lives.
class ShimFolder {
public:
    ShimFolder() {
        if (::mkdtemp(path_.data()) == nullptr) throw std::runtime_error("no temporary folder");
        ::setenv("HIDSHIM", path_.c_str(), 1);
    }
    ~ShimFolder() {
        ::unsetenv("HIDSHIM");
        std::filesystem::remove_all(path_);
    }
    ShimFolder(const ShimFolder&) = delete;
    ShimFolder& operator=(const ShimFolder&) = delete;
    [[nodiscard]] const std::string& path() const { return path_; }

private:
    std::string path_ = "/tmp/hidshim-XXXXXX";
};

// One node: what the kernel and the cable do.
class VirtualNode {
public:
    VirtualNode(const ShimFolder& folder, const std::string& name, const std::string& serial)
        : place_(folder.path() + "/" + name) {
        plug(serial);
    }
    ~VirtualNode() { unplug(); }
    VirtualNode(const VirtualNode&) = delete;
    VirtualNode& operator=(const VirtualNode&) = delete;

    void plug(const std::string& serial) {
        std::filesystem::create_directory(place_);
        set("serial", serial);
        set("product", "virtual stylus");
        listening_ = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
        sockaddr_un address{};
        address.sun_family = AF_UNIX;
        std::strncpy(address.sun_path, (place_ + "/socket").c_str(), sizeof(address.sun_path) - 1);
        if (::bind(listening_, reinterpret_cast<sockaddr*>(&address), sizeof(address)) != 0 ||
            ::listen(listening_, 8) != 0) {
            throw std::runtime_error("no socket for the virtual device");
        }
    }
    void unplug() {
        accept_new();
        for (const int handle : handles_) {
            ::shutdown(handle, SHUT_RDWR);
            ::close(handle);
        }
        handles_.clear();
        if (listening_ >= 0) ::close(listening_);
        listening_ = -1;
        std::filesystem::remove_all(place_);
    }
    void set(const std::string& file, const std::string& content) { std::ofstream(place_ + "/" + file) << content; }

    // To every open handle, as hidraw does; dropped where a queue is full.
    void send(const Report& report) {
        accept_new();
        for (const int handle : handles_) {
            (void)::send(handle, report.data(), report.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
        }
    }
    // The next report from any handle; waits for one up to `most_s` of real time.
    [[nodiscard]] std::optional<Report> receive(double most_s) {
        accept_new();
        for (int i = 0; i < static_cast<int>(most_s * 1e4) + 1; ++i) {
            for (const int handle : handles_) {
                Report report(1100);
                const ssize_t bytes = ::recv(handle, report.data(), report.size(), MSG_DONTWAIT);
                if (bytes <= 0) continue;
                report.resize(static_cast<std::size_t>(bytes));
                return report;
            }
            if (most_s > 0.0) ::usleep(100);
        }
        return std::nullopt;
    }

private:
    void accept_new() {
        for (int handle = 0; listening_ >= 0 && handle >= 0;) {
            handle = ::accept4(listening_, nullptr, nullptr, SOCK_CLOEXEC);
            if (handle >= 0) handles_.push_back(handle);
        }
    }
    std::string place_;
    int listening_ = -1;
    std::vector<int> handles_;
};

// What the device's firmware does with its reports.
struct Firmware {
    std::uint32_t seq = 0, t_us = 0, echo_seq = 0;
    float position_mm[3] = {0.0f, 0.0f, 0.0f};
    std::uint16_t status = 1 << 4;  // calibrated
    std::uint16_t buttons = 0;
    float force_n[3] = {0.0f, 0.0f, 0.0f};
    bool enabled = false;
    std::uint32_t forces = 0, bad_checksums = 0, watchdog_ms = 0;
    double silent_ms = 0.0;

    [[nodiscard]] Report report() const {
        Report out(64, 0);
        const auto put = [&out](std::size_t offset, const auto& value) {
            std::memcpy(&out[offset], &value, sizeof(value));
        };
        put(0, seq);
        put(4, t_us);
        put(8, position_mm);
        put(32, buttons);
        put(34, status);
        put(36, echo_seq);
        return out;
    }
    // With the report id in front, as written.
    void take(const Report& report) {
        if (report.size() != 65) throw std::runtime_error("an output report of the wrong length");
        const std::uint8_t* at = report.data() + 1;
        std::uint16_t crc = 0, flags = 0, watchdog = 0;
        std::memcpy(&crc, at + 62, 2);
        if (crc != station::crc16_ccitt(at, 62)) {
            ++bad_checksums;
            return;
        }
        std::memcpy(&echo_seq, at, 4);
        std::memcpy(force_n, at + 4, 12);
        std::memcpy(&flags, at + 16, 2);
        std::memcpy(&watchdog, at + 18, 2);
        watchdog_ms = watchdog;
        enabled = (flags & 1) != 0;
        ++forces;
        silent_ms = 0.0;
        status = static_cast<std::uint16_t>(status & ~(1 << 3));
    }
    // A millisecond passes: its watchdog lets go of the motors when nobody has written.
    void step() {
        ++seq;
        t_us += 1000;
        silent_ms += 1.0;
        if (watchdog_ms > 0 && silent_ms > watchdog_ms) {
            for (float& axis : force_n) axis = 0.0f;
            enabled = false;
            status = static_cast<std::uint16_t>(status | (1 << 3));
        }
    }
    [[nodiscard]] double force() const {
        return std::hypot(double{force_n[0]}, double{force_n[1]}, double{force_n[2]});
    }
};

}  // namespace hapticlod::test
