// A histogram of durations that records without allocating: 128 steps per octave, so a percentile is within 0.8 %.
#pragma once
#include <array>
#include <cstdint>

namespace hapticlod::station {

class Histogram {
public:
    void record(std::int64_t duration_ns) noexcept;  // negative counts as 0

    [[nodiscard]] std::uint64_t count() const { return count_; }
    [[nodiscard]] double mean_us() const;
    [[nodiscard]] double max_us() const { return static_cast<double>(max_ns_) * 1e-3; }
    // Smallest recorded duration (to 0.8 %, never above the maximum) that `fraction` of all do not exceed; 0 if none.
    [[nodiscard]] double percentile_us(double fraction) const;

private:
    static constexpr unsigned kStepBits = 7;
    static constexpr std::size_t kBins = (64 - kStepBits + 1) << kStepBits;
    [[nodiscard]] static std::size_t bin(std::uint64_t duration_ns);
    [[nodiscard]] static std::uint64_t upper_ns(std::size_t bin);

    std::array<std::uint64_t, kBins> bins_{};
    std::uint64_t count_ = 0;
    std::uint64_t sum_ns_ = 0;
    std::uint64_t max_ns_ = 0;
};

}  // namespace hapticlod::station
