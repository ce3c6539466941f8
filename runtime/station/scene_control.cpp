#include "station/scene_control.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <limits>

namespace hapticlod::station {
namespace {

constexpr std::size_t kMostLine = 4096;

std::string trimmed(const std::string& text) {
    const auto first = text.find_first_not_of(" \t\r"), last = text.find_last_not_of(" \t\r");
    return first == std::string::npos ? "" : text.substr(first, last - first + 1);
}

}  // namespace

struct SceneControl::Held {
    Bundle bundle;
    std::vector<LevelStorage> moved;  // levels about the scene's origin, where the bundle has another
    std::unique_ptr<Part> part;
    std::uint32_t place = 0;
    std::uint64_t replaced_by = std::numeric_limits<std::uint64_t>::max();  // the wish that no longer names it
};

SceneControl::SceneControl(std::string pipe, const Bundle& bundle, const Renderer& renderer, Believes believes)
    : pipe_(std::move(pipe)), bundle_(bundle), renderer_(renderer), believes_(std::move(believes)) {
    wish_.visible = bundle.visible();
}

Result<std::unique_ptr<SceneControl>> SceneControl::start(const std::string& pipe, const Bundle& bundle,
                                                          const Renderer& renderer, Believes believes) {
    if (bundle.parts().empty()) return Fault{pipe, "has nothing to control: the bundle has no parts", "leave it out"};
    std::unique_ptr<SceneControl> control(new SceneControl(pipe, bundle, renderer, std::move(believes)));
    control->made_pipe_ = ::mkfifo(pipe.c_str(), 0600) == 0;
    struct stat about {};
    // Open for writing, too: without a writer a pipe is at its end.
    const int fd = ::open(pipe.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0 || ::fstat(fd, &about) != 0 || !S_ISFIFO(about.st_mode)) {
        if (fd >= 0) ::close(fd);
        return Fault{pipe, "is no pipe and cannot be made one", "name a file that does not exist yet"};
    }
    control->thread_ = std::thread([raw = control.get(), fd] { raw->read_lines(fd); });
    return control;
}

SceneControl::~SceneControl() {
    end_.store(true, std::memory_order_release);
    if (thread_.joinable()) thread_.join();
    if (made_pipe_) ::unlink(pipe_.c_str());
}

void SceneControl::read_lines(int fd) {
    std::string line;
    while (!end_.load(std::memory_order_acquire)) {
        pollfd input{fd, POLLIN, 0};
        if (::poll(&input, 1, 50) <= 0) continue;
        char bytes[256];
        const ssize_t got = ::read(fd, bytes, sizeof(bytes));
        for (ssize_t i = 0; i < got; ++i) {
            if (bytes[i] != '\n') {
                if (line.size() < kMostLine) line += bytes[i];
                continue;
            }
            std::fprintf(stderr, "%s\n", obey(line).c_str());
            line.clear();
        }
    }
    ::close(fd);
}

std::string SceneControl::obey(const std::string& line) {
    const std::string words = trimmed(line);
    const auto space = words.find(' ');
    const std::string verb = words.substr(0, space);
    std::string name = space == std::string::npos ? "" : trimmed(words.substr(space));
    if (verb != "hide" && verb != "show" && verb != "swap") {
        return "control: '" + words + "' is no command; give hide PART, show PART or swap PART FILE.hlod";
    }
    std::string file;
    if (verb == "swap") {
        const auto last = name.find_last_of(' ');
        if (last == std::string::npos) return "control: swap needs a part and a bundle; give swap PART FILE.hlod";
        file = name.substr(last + 1), name = trimmed(name.substr(0, last));
    }
    const std::optional<std::uint32_t> part = bundle_.part_named(name);
    if (!part) return "control: there is no part '" + name + "'; inspect lists them";
    if (verb == "swap") return swap(*part, name, file);
    const std::uint64_t bit = std::uint64_t{1} << *part;
    wish_.visible = verb == "show" ? wish_.visible | bit : wish_.visible & ~bit;
    post();
    return name + (verb == "show" ? ": shown" : ": hidden");
}

std::string SceneControl::swap(std::uint32_t place, const std::string& name, const std::string& file) {
    auto opened = Bundle::open(file);
    if (!opened) return "control: " + opened.fault().line();
    if (std::string reason = believes_(opened.value()); !reason.empty()) return "control: " + reason;
    Held held{std::move(opened).value(), {}, nullptr, place};
    const std::optional<std::uint32_t> inside = held.bundle.part_named(name);
    if (!held.bundle.parts().empty() && !inside) return "control: " + file + ": has no part '" + name + "'";
    std::span<const LevelView> levels = held.bundle.levels_of(inside.value_or(0));
    levels = levels.first(std::min<std::size_t>(levels.size(), bundle_.config().level_count));
    const double* from = held.bundle.config().origin_mm;
    const double* to = bundle_.config().origin_mm;
    std::vector<LevelView> views(levels.begin(), levels.end());
    if (!std::equal(from, from + 3, to)) {
        held.moved.resize(levels.size());
        for (std::size_t k = 0; k < levels.size(); ++k) {
            std::vector<float> vertices(levels[k].vertices.begin(), levels[k].vertices.end());
            for (std::size_t i = 0; i < vertices.size(); ++i)
                vertices[i] = static_cast<float>(double{vertices[i]} + from[i % 3] - to[i % 3]);
            std::string reason = held.moved[k].build(vertices, levels[k].faces, levels[k].hash->cell_mm);
            if (reason.empty()) reason = held.moved[k].set_materials(levels[k].materials);
            if (!reason.empty()) return "control: " + file + ": " + reason;
            views[k] = held.moved[k].view();
        }
    }
    held.part = std::make_unique<Part>(views);
    if (const std::string reason = renderer_.refusal(place, *held.part); !reason.empty())
        return "control: " + file + ": " + reason;
    for (Held& other : held_)
        if (other.place == place) other.replaced_by = std::min(other.replaced_by, wish_.number + 1);
    wish_.parts[place] = held.part.get();
    held_.push_back(std::move(held));
    post();
    return name + ": swapped for " + file;
}

void SceneControl::post() {
    ++wish_.number;
    mailbox_.slot() = wish_;
    mailbox_.post();
    // What the loop has let go of.
    const std::uint64_t applied = applied_.load(std::memory_order_acquire);
    held_.remove_if([applied](const Held& held) { return held.replaced_by <= applied; });
}

void SceneControl::apply(Renderer& renderer) noexcept {
    const SceneWish* wish = mailbox_.take();
    if (wish == nullptr) return;
    renderer.show(wish->visible);
    for (std::uint32_t i = 0; i < kMaxParts; ++i) {
        if (wish->parts[i] == nullptr || wish->parts[i] == in_use_[i]) continue;
        if (renderer.exchange(i, *wish->parts[i]) != nullptr) in_use_[i] = wish->parts[i];
    }
    applied_.store(wish->number, std::memory_order_release);
}

}  // namespace hapticlod::station
