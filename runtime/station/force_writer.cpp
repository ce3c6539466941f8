#include "station/force_writer.hpp"

#include <sched.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <thread>
#include <utility>

#include "station/mailbox.hpp"
#include "station/realtime.hpp"

namespace hapticlod::station {
namespace {

constexpr std::int64_t kIdle = -1;
}

struct ForceWriter::Shared {
    struct Message {
        std::int64_t posted_ns = 0;
        std::size_t size = 0;
        std::array<std::uint8_t, kMaxReportBytes + 1> bytes{};
    };

    explicit Shared(HidConnection opened) : connection(std::move(opened)) {}
    HidConnection connection;
    Mailbox<Message> mailbox;
    std::atomic<bool> stop{false}, failed{false}, ended{false};
    std::atomic<std::int64_t> writing_since_ns{kIdle};
    std::atomic<std::uint64_t> written{0};
    std::atomic<std::uint32_t> seen{0};  // the post up to which everything is dealt with

    void run() {
        sched_param priority{};
        priority.sched_priority = kFifoPriority - 1;
        (void)::sched_setscheduler(0, SCHED_FIFO, &priority);  // whether it may, acquire_real_time has said
        while (!stop.load(std::memory_order_acquire)) {
            const std::uint32_t posts = mailbox.posts();
            const Message* message = mailbox.take();
            if (message == nullptr) {
                seen.store(posts, std::memory_order_release);
                mailbox.wait(posts);
                continue;
            }
            writing_since_ns.store(message->posted_ns, std::memory_order_release);
            const int sent = connection.write({message->bytes.data(), message->size});
            writing_since_ns.store(kIdle, std::memory_order_release);
            if (sent < 0) {
                failed.store(true, std::memory_order_release);
                break;
            }
            written.fetch_add(1, std::memory_order_release);
        }
        ended.store(true, std::memory_order_release);
    }
};

ForceWriter::ForceWriter(HidConnection connection) : shared_(std::make_shared<Shared>(std::move(connection))) {
    std::thread([shared = shared_] { shared->run(); }).detach();
}

ForceWriter::~ForceWriter() {
    shared_->stop.store(true, std::memory_order_release);
    shared_->mailbox.wake();
    // A blocked write ends when the kernel gives up; nobody waits for that.
    for (int i = 0; i < 200 && !shared_->ended.load(std::memory_order_acquire); ++i) {
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
}

void ForceWriter::post(std::span<const std::uint8_t> report, std::int64_t now_ns) noexcept {
    Shared::Message& message = shared_->mailbox.slot();
    message.posted_ns = now_ns;
    message.size = std::min(report.size(), message.bytes.size());
    std::copy_n(report.begin(), message.size, message.bytes.begin());
    shared_->mailbox.post();
}

bool ForceWriter::failed() const noexcept { return shared_->failed.load(std::memory_order_acquire); }

double ForceWriter::writing_s(std::int64_t now_ns) const noexcept {
    const std::int64_t since_ns = shared_->writing_since_ns.load(std::memory_order_acquire);
    return since_ns == kIdle ? 0.0 : static_cast<double>(std::max<std::int64_t>(0, now_ns - since_ns)) * 1e-9;
}

std::uint64_t ForceWriter::written() const noexcept { return shared_->written.load(std::memory_order_acquire); }

bool ForceWriter::flush(double seconds) const noexcept {
    const std::uint32_t target = shared_->mailbox.posts();
    const auto until = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
    while (static_cast<std::int32_t>(shared_->seen.load(std::memory_order_acquire) - target) < 0) {
        if (failed() || std::chrono::steady_clock::now() >= until) return false;
        std::this_thread::sleep_for(std::chrono::microseconds(50));
    }
    return true;
}

}  // namespace hapticlod::station
