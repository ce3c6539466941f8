// The tick: position in, force out. One Renderer serves one tool in one loop; it is not shared between threads.
// Allocates while constructed and in load(); tick() allocates nothing, takes no lock, makes no system call,
// throws nothing and logs nothing (tests/tick_hygiene).
#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "core/level.hpp"

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
