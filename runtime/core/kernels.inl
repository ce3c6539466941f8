// Included by kernels_baseline.cpp and kernels_avx2.cpp with HAPTICLOD_KERNEL_SPACE set. Vectors are GCC/clang vector
// extensions: lowered to whatever the translation unit may use. No standard header here: an inline function of theirs
// compiled for AVX2 must never be the copy that the linker keeps.
namespace hapticlod::HAPTICLOD_KERNEL_SPACE {
namespace {

typedef float F8 __attribute__((vector_size(32)));
typedef std::int32_t I8 __attribute__((vector_size(32)));

#define HAPTICLOD_INLINE static inline __attribute__((always_inline))

HAPTICLOD_INLINE void load(const float* p, F8& out) { __builtin_memcpy(&out, p, sizeof(F8)); }
HAPTICLOD_INLINE void store(float* p, const F8& v) { __builtin_memcpy(p, &v, sizeof(F8)); }

struct V8 {
    F8 x, y, z;
};

#define V8_SUB(r, a, b) r.x = (a).x - (b).x, r.y = (a).y - (b).y, r.z = (a).z - (b).z
#define V8_DOT(a, b) ((a).x * (b).x + (a).y * (b).y + (a).z * (b).z)
#define V8_CROSS(r, a, b) \
    r.x = (a).y * (b).z - (a).z * (b).y, r.y = (a).z * (b).x - (a).x * (b).z, r.z = (a).x * (b).y - (a).y * (b).x
#define SELECT(mask, a, b) ((F8)(((mask) & (I8)(a)) | (~(mask) & (I8)(b))))

// Parameter of the point of segment [0, e] nearest to q; 0 for a segment of no length.
#define SEGMENT(t, e, q)                          \
    do {                                          \
        const F8 ee_ = V8_DOT(e, e);              \
        const I8 ok_ = ee_ > zero;                \
        t = V8_DOT(e, q) / SELECT(ok_, ee_, one); \
        t = SELECT(t > zero, t, zero);            \
        t = SELECT(t < one, t, one);              \
        t = SELECT(ok_, t, zero);                 \
    } while (0)

// r = q - t e: from the nearest point of the segment to the query.
#define RESIDUAL(r, q, t, e) r.x = (q).x - (t) * (e).x, r.y = (q).y - (t) * (e).y, r.z = (q).z - (t) * (e).z

// Vector from the closest point of each triangle to the query point, and its squared length.
HAPTICLOD_INLINE void residual(const float (*v)[8], const float p[3], V8& best, F8& best2) {
    const F8 zero = {0, 0, 0, 0, 0, 0, 0, 0};
    const F8 one = zero + 1.0f;
    V8 a, b, c, q{zero + p[0], zero + p[1], zero + p[2]};
    load(v[0], a.x), load(v[1], a.y), load(v[2], a.z);
    load(v[3], b.x), load(v[4], b.y), load(v[5], b.z);
    load(v[6], c.x), load(v[7], c.y), load(v[8], c.z);
    V8 ab, ac, bc, ap, bp, n;
    V8_SUB(ab, b, a), V8_SUB(ac, c, a), V8_SUB(bc, c, b), V8_SUB(ap, q, a), V8_SUB(bp, q, b);
    V8_CROSS(n, ab, ac);
    F8 t;
    V8 r;
    SEGMENT(t, ab, ap);
    RESIDUAL(best, ap, t, ab);
    best2 = V8_DOT(best, best);
    SEGMENT(t, ac, ap);
    RESIDUAL(r, ap, t, ac);
    F8 r2 = V8_DOT(r, r);
    I8 less = r2 < best2;
    best.x = SELECT(less, r.x, best.x), best.y = SELECT(less, r.y, best.y), best.z = SELECT(less, r.z, best.z);
    best2 = SELECT(less, r2, best2);
    SEGMENT(t, bc, bp);
    RESIDUAL(r, bp, t, bc);
    r2 = V8_DOT(r, r);
    less = r2 < best2;
    best.x = SELECT(less, r.x, best.x), best.y = SELECT(less, r.y, best.y), best.z = SELECT(less, r.z, best.z);
    best2 = SELECT(less, r2, best2);
    const F8 nn = V8_DOT(n, n);
    V8 ab_ap, ap_ac;
    V8_CROSS(ab_ap, ab, ap), V8_CROSS(ap_ac, ap, ac);
    const F8 wc = V8_DOT(n, ab_ap), wb = V8_DOT(n, ap_ac);
    const I8 inside = (nn > zero) & (wb >= zero) & (wc >= zero) & (wb + wc <= nn);
    const F8 height = V8_DOT(n, ap) / SELECT(nn > zero, nn, one);
    r.x = n.x * height, r.y = n.y * height, r.z = n.z * height;
    r2 = V8_DOT(r, r);
    best.x = SELECT(inside, r.x, best.x), best.y = SELECT(inside, r.y, best.y), best.z = SELECT(inside, r.z, best.z);
    best2 = SELECT(inside, r2, best2);
}

// Bit k: lane k of a comparison's result.
HAPTICLOD_INLINE std::uint32_t bits_of(const I8& mask) {
#if defined(__AVX__)
    return static_cast<std::uint32_t>(__builtin_ia32_movmskps256((F8)mask));
#elif defined(__SSE__)
    typedef float F4 __attribute__((vector_size(16)));
    F4 half[2];
    __builtin_memcpy(half, &mask, sizeof(mask));
    return static_cast<std::uint32_t>(__builtin_ia32_movmskps(half[0]) | __builtin_ia32_movmskps(half[1]) << 4);
#else
    std::uint32_t bits = 0;
    for (int k = 0; k < 8; ++k) bits |= static_cast<std::uint32_t>(mask[k] & 1) << k;
    return bits;
#endif
}

HAPTICLOD_INLINE void root(const F8& v, F8& out) {
    for (int k = 0; k < 8; ++k) out[k] = __builtin_sqrtf(v[k]);
}

}  // namespace

float eval(const ItemBlock& block, const float p[3], EvalBlock& out) {
    V8 r;
    F8 r2, radius;
    residual(block.v, p, r, r2);
    load(block.radius, radius);
    const F8 zero = {0, 0, 0, 0, 0, 0, 0, 0};
    F8 d;
    root(r2, d);
    const F8 inverse = 1.0f / SELECT(d > zero, d, zero + 1.0f);
    const V8 n{r.x * inverse, r.y * inverse, r.z * inverse};
    // n.c + radius with c = p - r: n.c = n.p - d.
    store(out.nx, n.x), store(out.ny, n.y), store(out.nz, n.z);
    store(out.offset, n.x * p[0] + n.y * p[1] + n.z * p[2] - d + radius);
    store(out.clearance, d - radius);
    float least = out.clearance[0];
    for (int k = 1; k < 8; ++k) least = out.clearance[k] < least ? out.clearance[k] : least;
    return least;
}

void place(const TriBlock& block, const float shift[3], const float residual[3], float radius, ItemBlock& out) {
    for (int row = 0; row < 9; ++row) {
        F8 v;
        load(block.v[row], v);
        store(out.v[row], (v - shift[row % 3]) - residual[row % 3]);
    }
    for (int k = 0; k < 8; ++k) {
        out.radius[k] = radius;
        out.triangle[k] = block.id[k] == kNoNeighbour ? block.id[0] : block.id[k];
    }
}

std::uint32_t crossed(const EvalBlock& block, const float y[3], float margin) {
    V8 n;
    F8 offset;
    load(block.nx, n.x), load(block.ny, n.y), load(block.nz, n.z), load(block.offset, offset);
    return bits_of((n.x * y[0] + n.y * y[1] + n.z * y[2] - offset) < margin);
}

void near(const BlockBound* bounds, std::uint32_t count, const BallPack& balls, const float centre[3],
          std::uint32_t active, float reach, float* least, float* low, std::uint32_t* bits) {
    V8 at;
    F8 kept, nearest;
    load(balls.x, at.x), load(balls.y, at.y), load(balls.z, at.z), load(balls.kept, kept), load(least, nearest);
    for (std::uint32_t b = 0; b < count; ++b) {
        const BlockBound& block = bounds[b];
        V8 r;
        r.x = (block.x - centre[0]) - at.x, r.y = (block.y - centre[1]) - at.y, r.z = (block.z - centre[2]) - at.z;
        F8 d;
        root(V8_DOT(r, r), d);
        d -= block.radius;
        F8 h = r.x * block.nx + r.y * block.ny + r.z * block.nz;
        h = SELECT(h > 0.0f, h, -h) - block.half;
        d = SELECT(d > h, d, h) - kept;
        const I8 within = d <= reach;
        bits[b] = bits_of(within) & active;
        nearest = SELECT(~within & (d < nearest), d, nearest);
        store(low + 8 * b, d);
    }
    store(least, nearest);
}

}  // namespace hapticlod::HAPTICLOD_KERNEL_SPACE
