// One value, always the latest: a triple buffer between one producer and one consumer. Neither ever waits for the other
// inside post(); wait() sleeps until there is something new.
#pragma once
#include <array>
#include <atomic>
#include <cstdint>

namespace hapticlod::station {

template <class T>
class Mailbox {
public:
    // Producer: fill slot(), then post(). What the consumer has not taken is replaced.
    [[nodiscard]] T& slot() noexcept { return slots_[mine_]; }
    void post() noexcept {
        const std::uint8_t old = shared_.exchange(static_cast<std::uint8_t>(mine_ | kNew), std::memory_order_acq_rel);
        mine_ = old & kIndex;
        posts_.fetch_add(1, std::memory_order_release);
        posts_.notify_one();
    }

    // Consumer: the newest value, or nullptr where there is none since the last call. Valid until the next call.
    [[nodiscard]] const T* take() noexcept {
        if ((shared_.load(std::memory_order_relaxed) & kNew) == 0) return nullptr;
        theirs_ = shared_.exchange(theirs_, std::memory_order_acq_rel) & kIndex;
        return &slots_[theirs_];
    }
    // Consumer: sleeps while posts() is `seen`.
    void wait(std::uint32_t seen) const noexcept { posts_.wait(seen, std::memory_order_acquire); }
    [[nodiscard]] std::uint32_t posts() const noexcept { return posts_.load(std::memory_order_acquire); }
    // Wakes the consumer without a value.
    void wake() noexcept {
        posts_.fetch_add(1, std::memory_order_release);
        posts_.notify_one();
    }

private:
    static constexpr std::uint8_t kNew = 4, kIndex = 3;
    std::array<T, 3> slots_{};
    std::uint8_t mine_ = 0, theirs_ = 1;   // the producer's slot, the consumer's
    std::atomic<std::uint8_t> shared_{2};  // the slot between them, and whether it is new
    std::atomic<std::uint32_t> posts_{0};
};

}  // namespace hapticlod::station
