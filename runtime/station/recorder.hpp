// Recordings of what the loop did, as MCAP: all of a run (a thread that follows the ring) or its last seconds (the
// flight recorder, after a fault). Neither touches the loop.
#pragma once
#include <atomic>
#include <optional>
#include <string>
#include <thread>

#include "station/mcap_writer.hpp"
#include "station/telemetry.hpp"

namespace hapticlod::station {

// One frame as the JSON message of topic /station/tick.
[[nodiscard]] std::string frame_json(const TelemetryFrame& frame, const TelemetrySource& source);
[[nodiscard]] McapWriter::Channel recording_channel();

// Follows the ring until stopped. Frames that it could not follow are counted, never made up.
class Recorder {
public:
    [[nodiscard]] static Result<std::unique_ptr<Recorder>> start(const std::string& path, const TelemetryRing& ring);
    ~Recorder();
    // Takes what is left, closes the file.
    [[nodiscard]] std::optional<Fault> stop();
    [[nodiscard]] std::uint64_t missed() const { return missed_; }
    [[nodiscard]] std::uint64_t recorded() const { return writer_.messages(); }

private:
    Recorder(McapWriter writer, const TelemetryRing& ring) : writer_(std::move(writer)), ring_(ring) {}
    void follow();

    McapWriter writer_;
    const TelemetryRing& ring_;
    std::uint64_t next_ = 0, missed_ = 0;
    std::atomic<bool> stop_{false};
    std::thread thread_;
};

inline constexpr double kFlightSeconds = 10.0;

// The last ten seconds into `folder` (made if it is not there), named by date and process. Gives the path.
[[nodiscard]] Result<std::string> write_flight_recording(const TelemetryRing& ring, const std::string& folder);
// Where these go unless told otherwise: $XDG_STATE_HOME/hapticlod, else ~/.local/state/hapticlod.
[[nodiscard]] std::string flight_folder();

}  // namespace hapticlod::station
