// A place in double precision as kernels take it: the float nearest to it, and what that leaves.
#pragma once
#include "core/vec.hpp"

namespace hapticlod {

struct FloatPlace {
    float shift[3], residual[3];

    explicit FloatPlace(const Vec3& p) {
        const double at[3] = {p.x, p.y, p.z};
        for (int k = 0; k < 3; ++k) {
            shift[k] = static_cast<float>(at[k]);
            residual[k] = static_cast<float>(at[k] - double{shift[k]});
        }
    }
};

}  // namespace hapticlod
