// The kernels for any x86-64 (or other) processor, and the choice between the two builds.
#include "core/kernels.hpp"

#define HAPTICLOD_KERNEL_SPACE baseline
#include "core/kernels.inl"

namespace hapticlod {

namespace avx2 {
extern const Kernels kTable;
}

const Kernels& scalar_kernels() noexcept {
    static constexpr Kernels table{"baseline",        baseline::eval,   baseline::near,   baseline::near_one,
                                   baseline::highest, baseline::beside, baseline::facing, baseline::above,
                                   baseline::granted, baseline::crossed};
    return table;
}

const Kernels& best_kernels() noexcept {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) return avx2::kTable;
#endif
    return scalar_kernels();
}

}  // namespace hapticlod
