#include "station/recorder.hpp"

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <memory>

#include "io/json_text.hpp"
#include "station/safety.hpp"

namespace hapticlod::station {
namespace {

constexpr const char* kTickSchema =
    R"({"title":"hapticlod.Tick","type":"object","properties":{)"
    R"("t_s":{"type":"number"},"device_s":{"type":"number"},)"
    R"("position_mm":{"type":"object","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}},)"
    R"("orientation":{"type":"object","properties":{"w":{"type":"number"},"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}},)"
    R"("scp_mm":{"type":"object","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}},)"
    R"("force_n":{"type":"object","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}},)"
    R"("speed_mm_s":{"type":"number"},"cost_us":{"type":"number"},"wake_up_us":{"type":"number"},)"
    R"("energy_out_mj":{"type":"number"},"level":{"type":"integer"},"contact":{"type":"boolean"},)"
    R"("mapping":{"type":"integer"},"fresh":{"type":"boolean"},"drained":{"type":"integer"},"lost":{"type":"integer"},)"
    R"("buttons":{"type":"integer"},"status":{"type":"integer"},"tick_errors":{"type":"integer"},)"
    R"("state":{"type":"string"},"fault":{"type":"string"}}})";

template <class T>
void write_vector(JsonWriter& json, const char* name, const T v[3]) {
    json.key(name).open('{');
    json.field("x", double{v[0]}).field("y", double{v[1]}).field("z", double{v[2]});
    json.close();
}

}  // namespace

McapWriter::Channel recording_channel() { return {"/station/tick", "hapticlod.Tick", kTickSchema}; }

std::string frame_json(const TelemetryFrame& frame, const TelemetrySource& source) {
    JsonWriter json;
    json.open('{');
    json.field("t_s", static_cast<double>(frame.now_ns - source.start_ns) * 1e-9).field("device_s", frame.device_s);
    write_vector(json, "position_mm", frame.position_mm);
    json.key("orientation").open('{');
    const float* q = frame.orientation;
    json.field("w", double{q[0]}).field("x", double{q[1]}).field("y", double{q[2]}).field("z", double{q[3]});
    json.close();
    write_vector(json, "scp_mm", frame.scp_mm);
    write_vector(json, "force_n", frame.force_n);
    json.field("speed_mm_s", double{frame.speed_mm_s}).field("cost_us", double{frame.cost_us});
    json.field("wake_up_us", double{frame.wake_up_us}).field("energy_out_mj", double{frame.energy_out_mj});
    json.field("level", std::uint32_t{frame.level}).field("contact", frame.contact != 0);
    json.field("mapping", std::uint32_t{frame.mapping}).field("fresh", frame.fresh != 0);
    json.field("drained", std::uint32_t{frame.drained}).field("lost", std::uint32_t{frame.lost});
    json.field("buttons", std::uint32_t{frame.buttons}).field("status", frame.device_status);
    json.field("tick_errors", frame.tick_errors);
    json.field("state", name_of(static_cast<State>(frame.state)));
    json.field("fault", name_of(static_cast<SafetyFault>(frame.fault)));
    return json.close().text();
}

Result<std::unique_ptr<Recorder>> Recorder::start(const std::string& path, const TelemetryRing& ring) {
    auto writer = McapWriter::create(path, recording_channel());
    if (!writer) return writer.fault();
    std::unique_ptr<Recorder> recorder(new Recorder(std::move(writer).value(), ring));
    recorder->thread_ = std::thread([raw = recorder.get()] {
        while (!raw->stop_.load(std::memory_order_acquire)) {
            raw->follow();
            std::this_thread::sleep_for(std::chrono::milliseconds(20));
        }
    });
    return recorder;
}

Recorder::~Recorder() {
    stop_.store(true, std::memory_order_release);
    if (thread_.joinable()) thread_.join();
}

std::optional<Fault> Recorder::stop() {
    stop_.store(true, std::memory_order_release);
    if (thread_.joinable()) thread_.join();
    follow();
    return writer_.close();
}

void Recorder::follow() {
    const TelemetrySource& source = ring_.source();
    TelemetryFrame frame;
    for (const std::uint64_t end = ring_.pushed(); next_ < end; ++next_) {
        if (!ring_.read(next_, frame)) {
            ++missed_;
            continue;
        }
        const auto time_ns = static_cast<std::uint64_t>(source.start_unix_ns + (frame.now_ns - source.start_ns));
        writer_.write(time_ns, frame_json(frame, source));
    }
}

std::string flight_folder() {
    if (const char* state = std::getenv("XDG_STATE_HOME"); state != nullptr && *state != '\0') {
        return std::string(state) + "/hapticlod";
    }
    const char* home = std::getenv("HOME");
    return std::string(home != nullptr ? home : ".") + "/.local/state/hapticlod";
}

Result<std::string> write_flight_recording(const TelemetryRing& ring, const std::string& folder) {
    std::error_code error;
    std::filesystem::create_directories(folder, error);
    const TelemetrySource& source = ring.source();
    const std::time_t now = std::time(nullptr);
    std::tm utc{};
    ::gmtime_r(&now, &utc);
    char stamp[32];
    std::strftime(stamp, sizeof(stamp), "%Y%m%dT%H%M%SZ", &utc);
    const std::string path = folder + "/flight-" + stamp + "-" + std::to_string(source.pid) + ".mcap";
    auto writer = McapWriter::create(path, recording_channel());
    if (!writer) return writer.fault();
    const auto frames = static_cast<std::uint64_t>(std::ceil(kFlightSeconds * source.loop_hz));
    for (const TelemetryFrame& frame : ring.newest(frames)) {
        const auto time_ns = static_cast<std::uint64_t>(source.start_unix_ns + (frame.now_ns - source.start_ns));
        writer.value().write(time_ns, frame_json(frame, source));
    }
    if (auto fault = writer.value().close()) return *fault;
    return path;
}

}  // namespace hapticlod::station
