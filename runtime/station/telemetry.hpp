// What every tick did, at loop rate, in shared memory: a ring that one loop writes and anyone may read. A reader maps
// it read-only and can neither stop nor slow the loop; a frame that was overwritten while it was copied is noticed.
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/layout.hpp"
#include "io/result.hpp"

namespace hapticlod::station {

struct TelemetryFrame {
    std::int64_t now_ns;  // the loop's clock at wake-up
    double device_s;      // the device's clock
    double position_mm[3], scp_mm[3];
    float orientation[4];
    float force_n[3];  // as sent
    float speed_mm_s;
    float cost_us, wake_up_us;
    float energy_out_mj;
    std::uint32_t tick_errors;
    std::uint32_t device_status;
    std::uint16_t drained, lost;  // reports, saturating
    std::uint16_t buttons;
    std::uint8_t level, contact, mapping;
    std::uint8_t state, fault;  // State and SafetyFault
    std::uint8_t fresh;         // a report came in this tick
};
static_assert(sizeof(TelemetryFrame) == 128 && std::is_trivially_copyable_v<TelemetryFrame>);

// Who writes the ring; set once.
struct TelemetrySource {
    std::uint32_t pid;
    std::uint32_t level_count;
    std::uint32_t triangles[kMaxLevels];
    double loop_hz, budget_us;
    std::int64_t start_unix_ns, start_ns;  // one instant by the calendar and by the loop's clock
    char bundle[256], device[64];
};

// Whether there is such a process, another user's included.
[[nodiscard]] bool process_lives(std::uint32_t pid);

class TelemetryRing {
public:
    // The writer's: room for at least `seconds` at the loop rate. Named after the process, so several stations can run;
    // what dead ones left behind is removed. The name goes away with the object.
    [[nodiscard]] static Result<TelemetryRing> create(const TelemetrySource& source, double seconds);
    // A reader's, of the station with this process id (0: the only one there is).
    [[nodiscard]] static Result<TelemetryRing> open(std::uint32_t pid);

    TelemetryRing(TelemetryRing&& other) noexcept { *this = std::move(other); }
    TelemetryRing& operator=(TelemetryRing&& other) noexcept;
    ~TelemetryRing();

    // From the loop: some 20 stores.
    void push(const TelemetryFrame& frame) noexcept;

    [[nodiscard]] std::uint64_t pushed() const noexcept;
    [[nodiscard]] std::uint64_t capacity() const noexcept;
    [[nodiscard]] const TelemetrySource& source() const noexcept;
    // Frame number `index`; false where it is not there yet or no longer.
    bool read(std::uint64_t index, TelemetryFrame& frame) const noexcept;
    // The newest frames, at most `count`, oldest first.
    [[nodiscard]] std::vector<TelemetryFrame> newest(std::uint64_t count) const;

private:
    struct Shared;
    TelemetryRing() = default;
    Shared* shared_ = nullptr;
    std::size_t bytes_ = 0;
    std::string owned_name_;  // of the writer
    std::uint64_t next_ = 0;
};

}  // namespace hapticlod::station
