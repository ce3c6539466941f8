// The tick: position in, force out. One Renderer serves one tool in one loop; it is not shared between threads.
// Allocates while constructed and in load(); tick() allocates nothing, takes no lock, makes no system call,
// throws nothing and logs nothing (tests/tick_hygiene).
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "core/scene.hpp"

namespace hapticlod {

struct Pose {
    double position_mm[3];                         // HIP, scan frame
    double orientation[4] = {1.0, 0.0, 0.0, 0.0};  // unit quaternion w x y z, tool frame -> scan frame
};

class Renderer {
public:
    Renderer();
    ~Renderer();
    Renderer(Renderer&&) noexcept;
    Renderer& operator=(Renderer&&) noexcept;

    // Levels, finest first, must outlive the renderer. Returns the reason when refused (empty: success).
    [[nodiscard]] std::string load(const ConfigData& config, std::span<const LevelView> levels,
                                   std::span<const BallData> tool);

    // Several parts; `visible` has a bit for each. config.level_count is the most that a part has. Parts must outlive
    // the renderer, or their exchange.
    [[nodiscard]] std::string load_scene(const ConfigData& config, std::span<const Part* const> parts,
                                         std::uint64_t visible, std::span<const BallData> tool);

    // Which parts there are from the next tick on: bits of parts that do not exist are left aside. Costs nothing now;
    // the tick that follows moves a tool that a shown part would swallow in front of it, and engages softly.
    void show(std::uint64_t visible) noexcept;
    [[nodiscard]] std::uint64_t visible() const noexcept;
    // Parts that held the tool in the last tick.
    [[nodiscard]] std::uint64_t touched() const noexcept;

    // From the next tick on the part is this one. Returns the one before, which is not used any more from now on, or
    // nullptr where `next` is refused: refusal() says why, and is to be asked beforehand, where there is time. That may
    // be on another thread: it reads nothing that changes.
    const Part* exchange(std::uint32_t part, const Part& next) noexcept;
    [[nodiscard]] std::string refusal(std::uint32_t part, const Part& next) const;

    // One pass of the loop. time_s is the device's clock. cost_ns is left 0: the caller times the call.
    void tick(const Pose& pose, double time_s, TickRecord& out) noexcept;

    // Forget contact, speed and blend; the next tick starts as the first.
    void reset() noexcept;

    // Time-critical LOD: for the next ticks use at least this level (0: none), whatever the speed.
    void set_coarsest_floor(std::uint32_t level) noexcept;

    [[nodiscard]] const ConfigData& config() const noexcept;
    [[nodiscard]] std::size_t scratch_bytes() const noexcept;

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace hapticlod
