// The kernels compiled for AVX2 (CMake sets -mavx2 on x86-64 for this file alone).
#include "core/kernels.hpp"

#define HAPTICLOD_KERNEL_SPACE avx2
#include "core/kernels.inl"

namespace hapticlod::avx2 {

extern const Kernels kTable;
const Kernels kTable{"avx2", eval, near, near_one, highest, beside, facing, above, granted, crossed};

}  // namespace hapticlod::avx2
