// Parts hidden, shown and swapped while the loop runs. Lines on a named pipe are read, and new parts prepared, by a
// thread of its own; the loop takes the newest wish at the beginning of a tick and gives parts back by saying so.
#pragma once
#include <array>
#include <atomic>
#include <functional>
#include <list>
#include <memory>
#include <string>
#include <thread>

#include "core/renderer.hpp"
#include "io/bundle.hpp"
#include "station/mailbox.hpp"

namespace hapticlod::station {

// What the loop is to render from now on; parts without a pointer stay as they are in the bundle.
struct SceneWish {
    std::uint64_t number = 0;
    std::uint64_t visible = 0;
    std::array<const Part*, kMaxParts> parts{};
};

class SceneControl {
public:
    // Says why a bundle is not believed; empty: it is.
    using Believes = std::function<std::string(const Bundle&)>;

    // Makes the pipe where there is none, and removes it in the end if it made it. Bundle and renderer, which is
    // loaded with it, must outlive this.
    [[nodiscard]] static Result<std::unique_ptr<SceneControl>> start(const std::string& pipe, const Bundle& bundle,
                                                                     const Renderer& renderer, Believes believes);
    ~SceneControl();
    SceneControl(const SceneControl&) = delete;
    SceneControl& operator=(const SceneControl&) = delete;

    // The loop, before a tick: waits for nothing, allocates nothing, frees nothing.
    void apply(Renderer& renderer) noexcept;

    // One command, as a line of the pipe has it: `hide PART`, `show PART`, `swap PART FILE.hlod`. Returns what to tell
    // the operator. Called by this object's thread; tests call it in its place.
    std::string obey(const std::string& line);

private:
    struct Held;  // a bundle that a part was swapped in from, and the part

    SceneControl(std::string pipe, const Bundle& bundle, const Renderer& renderer, Believes believes);
    [[nodiscard]] std::string swap(std::uint32_t part, const std::string& name, const std::string& file);
    void post();
    void read_lines(int fd);

    std::string pipe_;
    bool made_pipe_ = false;
    const Bundle& bundle_;
    const Renderer& renderer_;
    Believes believes_;
    SceneWish wish_;
    std::list<Held> held_;
    Mailbox<SceneWish> mailbox_;
    std::array<const Part*, kMaxParts> in_use_{};  // the loop's
    std::atomic<std::uint64_t> applied_{0};
    std::atomic<bool> end_{false};
    std::thread thread_;
};

}  // namespace hapticlod::station
