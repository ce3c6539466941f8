#include "station/telemetry.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <new>
#include <utility>

namespace hapticlod::station {
namespace {

constexpr std::uint64_t kMagic = 0x31304C4554444C48ull;  // "HLDTEL01"
constexpr std::size_t kWords = sizeof(TelemetryFrame) / 8;
constexpr const char* kPrefix = "hapticlod-station.";
using SlotWords = std::array<std::uint64_t, kWords>;

// Process ids of all rings there are.
std::vector<std::uint32_t> rings() {
    std::vector<std::uint32_t> pids;
    std::error_code error;
    for (const auto& entry : std::filesystem::directory_iterator("/dev/shm", error)) {
        const std::string name = entry.path().filename();
        std::uint32_t pid = 0;
        if (!name.starts_with(kPrefix)) continue;
        const char* digits = name.data() + std::strlen(kPrefix);
        if (std::from_chars(digits, name.data() + name.size(), pid).ec == std::errc()) pids.push_back(pid);
    }
    return pids;
}

std::string name_of(std::uint32_t pid) { return std::string("/") + kPrefix + std::to_string(pid); }

}  // namespace

bool process_lives(std::uint32_t pid) { return ::kill(static_cast<pid_t>(pid), 0) == 0 || errno == EPERM; }

struct TelemetryRing::Shared {
    struct Slot {
        std::atomic<std::uint64_t> sequence;  // 2 i + 1 while frame i is written, 2 i + 2 when it is there
        std::array<std::atomic<std::uint64_t>, kWords> words;
    };
    std::uint64_t magic, frame_bytes, capacity;  // capacity: a power of two
    TelemetrySource source;
    std::atomic<std::uint64_t> pushed;
    alignas(64) Slot slots[1];  // `capacity` of them

    static std::size_t bytes_for(std::uint64_t capacity) { return sizeof(Shared) + (capacity - 1) * sizeof(Slot); }
};
static_assert(std::atomic<std::uint64_t>::is_always_lock_free);  // or it could not be shared between processes

Result<TelemetryRing> TelemetryRing::create(const TelemetrySource& source, double seconds) {
    for (const std::uint32_t pid : rings()) {
        if (!process_lives(pid)) ::shm_unlink(name_of(pid).c_str());
    }
    const std::string name = name_of(source.pid);
    const auto least = static_cast<std::uint64_t>(std::ceil(seconds * source.loop_hz));
    const std::uint64_t capacity = std::bit_ceil(std::max<std::uint64_t>(1024, least));
    TelemetryRing ring;
    ring.bytes_ = Shared::bytes_for(capacity);
    ::shm_unlink(name.c_str());
    const int file = ::shm_open(name.c_str(), O_CREAT | O_EXCL | O_RDWR | O_CLOEXEC, 0644);
    // posix_fallocate: a full /dev/shm shows here and not as SIGBUS in the loop.
    const int error = file < 0 ? errno : ::posix_fallocate(file, 0, static_cast<off_t>(ring.bytes_));
    void* place = error == 0 ? ::mmap(nullptr, ring.bytes_, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0) : MAP_FAILED;
    if (file >= 0) ::close(file);
    if (place == MAP_FAILED) {
        ::shm_unlink(name.c_str());
        return Fault{"/dev/shm" + name, std::string("no room for telemetry (") + std::strerror(error) + ")",
                     "make /dev/shm larger: a few MB are enough"};
    }
    ring.owned_name_ = name;
    ring.shared_ = static_cast<Shared*>(place);  // zeros, which is what its atomics start from
    ring.shared_->frame_bytes = sizeof(TelemetryFrame);
    ring.shared_->capacity = capacity;
    ring.shared_->source = source;
    ring.shared_->magic = kMagic;
    return ring;
}

Result<TelemetryRing> TelemetryRing::open(std::uint32_t pid) {
    if (pid == 0) {
        std::vector<std::uint32_t> there = rings();
        std::erase_if(there, [](std::uint32_t other) { return !process_lives(other); });
        if (there.empty()) return Fault{"hapticlod-station", "is not running", "start it with hapticlod-station run"};
        if (there.size() > 1) {
            std::string list;
            for (const std::uint32_t other : there) list += (list.empty() ? "" : ", ") + std::to_string(other);
            return Fault{"hapticlod-station", "runs " + std::to_string(there.size()) + " times (" + list + ")",
                         "choose one with --pid"};
        }
        pid = there.front();
    }
    const std::string name = name_of(pid);
    const int file = ::shm_open(name.c_str(), O_RDONLY | O_CLOEXEC, 0);
    struct stat status {};
    if (file < 0 || ::fstat(file, &status) != 0) {
        if (file >= 0) ::close(file);
        return Fault{"/dev/shm" + name, std::string("cannot be opened (") + std::strerror(errno) + ")",
                     "give the process id of a running hapticlod-station"};
    }
    TelemetryRing ring;
    ring.bytes_ = static_cast<std::size_t>(status.st_size);
    void* place =
        ring.bytes_ >= sizeof(Shared) ? ::mmap(nullptr, ring.bytes_, PROT_READ, MAP_SHARED, file, 0) : MAP_FAILED;
    ::close(file);
    if (place != MAP_FAILED) ring.shared_ = static_cast<Shared*>(place);
    const Shared* shared = ring.shared_;
    if (shared == nullptr || shared->magic != kMagic || shared->frame_bytes != sizeof(TelemetryFrame) ||
        !std::has_single_bit(shared->capacity) || shared->capacity > (1u << 28) ||
        Shared::bytes_for(shared->capacity) > ring.bytes_) {
        return Fault{"/dev/shm" + name, "is no telemetry of this version", "use the hapticlod-station that runs"};
    }
    return ring;
}

TelemetryRing& TelemetryRing::operator=(TelemetryRing&& other) noexcept {
    std::swap(shared_, other.shared_);
    std::swap(bytes_, other.bytes_);
    std::swap(owned_name_, other.owned_name_);
    std::swap(next_, other.next_);
    return *this;
}

TelemetryRing::~TelemetryRing() {
    if (shared_ != nullptr) ::munmap(shared_, bytes_);
    if (!owned_name_.empty()) ::shm_unlink(owned_name_.c_str());
}

// The words are stored with release and loaded with acquire: whoever sees one of frame i also sees that it is being
// written. On x86 these are plain moves.
void TelemetryRing::push(const TelemetryFrame& frame) noexcept {
    Shared::Slot& slot = shared_->slots[next_ & (shared_->capacity - 1)];
    const auto words = std::bit_cast<SlotWords>(frame);
    slot.sequence.store(2 * next_ + 1, std::memory_order_relaxed);
    for (std::size_t i = 0; i < kWords; ++i) slot.words[i].store(words[i], std::memory_order_release);
    slot.sequence.store(2 * next_ + 2, std::memory_order_release);
    shared_->pushed.store(++next_, std::memory_order_release);
}

std::uint64_t TelemetryRing::pushed() const noexcept { return shared_->pushed.load(std::memory_order_acquire); }
std::uint64_t TelemetryRing::capacity() const noexcept { return shared_->capacity; }
const TelemetrySource& TelemetryRing::source() const noexcept { return shared_->source; }

bool TelemetryRing::read(std::uint64_t index, TelemetryFrame& frame) const noexcept {
    const Shared::Slot& slot = shared_->slots[index & (shared_->capacity - 1)];
    if (slot.sequence.load(std::memory_order_acquire) != 2 * index + 2) return false;
    SlotWords words;
    for (std::size_t i = 0; i < kWords; ++i) words[i] = slot.words[i].load(std::memory_order_acquire);
    if (slot.sequence.load(std::memory_order_relaxed) != 2 * index + 2) return false;
    frame = std::bit_cast<TelemetryFrame>(words);
    return true;
}

std::vector<TelemetryFrame> TelemetryRing::newest(std::uint64_t count) const {
    const std::uint64_t end = pushed();
    std::uint64_t index = end - std::min({end, count, capacity()});
    std::vector<TelemetryFrame> frames;
    frames.reserve(end - index);
    TelemetryFrame frame;
    for (; index < end; ++index) {
        if (read(index, frame)) frames.push_back(frame);
    }
    return frames;
}

}  // namespace hapticlod::station
