#include "station/histogram.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace hapticlod::station {

// Below 2^kStepBits every nanosecond has its own bin; above, each octave has 2^kStepBits bins.
std::size_t Histogram::bin(std::uint64_t duration_ns) {
    const int width = std::bit_width(duration_ns);
    const int shift = std::max(0, width - static_cast<int>(kStepBits) - 1);
    return (static_cast<std::size_t>(shift) << kStepBits) + static_cast<std::size_t>(duration_ns >> shift);
}

std::uint64_t Histogram::upper_ns(std::size_t bin) {
    constexpr std::size_t kSteps = std::size_t{1} << kStepBits;
    if (bin < 2 * kSteps) return bin;
    const std::size_t shift = (bin >> kStepBits) - 1;
    return ((static_cast<std::uint64_t>(bin - (shift << kStepBits)) + 1) << shift) - 1;
}

void Histogram::record(std::int64_t duration_ns) noexcept {
    const auto duration = static_cast<std::uint64_t>(std::max<std::int64_t>(0, duration_ns));
    ++bins_[bin(duration)];
    ++count_;
    sum_ns_ += duration;
    max_ns_ = std::max(max_ns_, duration);
}

double Histogram::mean_us() const {
    return count_ == 0 ? 0.0 : static_cast<double>(sum_ns_) * 1e-3 / static_cast<double>(count_);
}

double Histogram::percentile_us(double fraction) const {
    if (count_ == 0) return 0.0;
    const double exact = std::ceil(fraction * static_cast<double>(count_));
    const std::uint64_t rank = std::clamp<std::uint64_t>(static_cast<std::uint64_t>(exact), 1, count_);
    std::uint64_t seen = 0;
    for (std::size_t i = 0; i < kBins; ++i) {
        seen += bins_[i];
        if (seen >= rank) return static_cast<double>(std::min(upper_ns(i), max_ns_)) * 1e-3;
    }
    return max_us();
}

}  // namespace hapticlod::station
