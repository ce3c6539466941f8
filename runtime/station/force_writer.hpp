// Sends forces from a thread of its own: a HID write takes a millisecond, and seconds when a device has stopped
// answering. The loop posts the newest report and goes on.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "station/hid_connection.hpp"

namespace hapticlod::station {

class ForceWriter {
public:
    // Starts the thread, with real-time priority below the loop's where it may.
    explicit ForceWriter(HidConnection connection);
    ~ForceWriter();
    ForceWriter(const ForceWriter&) = delete;
    ForceWriter& operator=(const ForceWriter&) = delete;

    // From the loop. `report` begins with the report id. `now_ns`: the loop's clock.
    void post(std::span<const std::uint8_t> report, std::int64_t now_ns) noexcept;
    [[nodiscard]] bool failed() const noexcept;  // the device is gone
    // How long ago, by the loop's clock, the report that is being written was posted; 0 where none is.
    [[nodiscard]] double writing_s(std::int64_t now_ns) const noexcept;
    [[nodiscard]] std::uint64_t written() const noexcept;
    // Waits until everything posted was written, or a write failed, at most this long. Not from the loop.
    bool flush(double seconds) const noexcept;

private:
    struct Shared;
    std::shared_ptr<Shared> shared_;  // the thread's too: it may outlive this object inside a blocked write
};

}  // namespace hapticlod::station
