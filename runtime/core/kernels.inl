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

// The corners as seen from the place (shift + residual).
HAPTICLOD_INLINE void corners(const float (*v)[8], const float shift[3], const float residual[3], V8& a, V8& b, V8& c) {
    F8 row;
#define CORNER(to, k) load(v[k], row), to = (row - shift[(k) % 3]) - residual[(k) % 3]
    CORNER(a.x, 0), CORNER(a.y, 1), CORNER(a.z, 2);
    CORNER(b.x, 3), CORNER(b.y, 4), CORNER(b.z, 5);
    CORNER(c.x, 6), CORNER(c.y, 7), CORNER(c.z, 8);
#undef CORNER
}

// Vector from the closest point of each triangle to the place (shift + residual), and its squared length.
HAPTICLOD_INLINE void nearest(const float (*v)[8], const float shift[3], const float residual[3], V8& best, F8& best2) {
    const F8 zero = {0, 0, 0, 0, 0, 0, 0, 0};
    const F8 one = zero + 1.0f;
    V8 a, b, c;
    corners(v, shift, residual, a, b, c);
    V8 ab, ac, bc, ap, bp, n;
    V8_SUB(ab, b, a), V8_SUB(ac, c, a), V8_SUB(bc, c, b), ap.x = -a.x, ap.y = -a.y, ap.z = -a.z, bp.x = -b.x,
                                                          bp.y = -b.y, bp.z = -b.z;
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

HAPTICLOD_INLINE void root(const F8& v, F8& out) {
    for (int k = 0; k < 8; ++k) out[k] = __builtin_sqrtf(v[k]);
}

// Eight bounds as eight vectors: row k of the result holds the k-th number of every bound.
HAPTICLOD_INLINE void transpose(const BlockBound* bounds, F8 (&row)[8]) {
    F8 a[8], b[8];
    const float* p = &bounds->x;
#define LOAD(k) load(p + 8 * (k), a[k])
    LOAD(0), LOAD(1), LOAD(2), LOAD(3), LOAD(4), LOAD(5), LOAD(6), LOAD(7);
#undef LOAD
#define PAIR(k)                                                                 \
    b[k] = __builtin_shufflevector(a[k], a[(k) + 1], 0, 8, 1, 9, 4, 12, 5, 13), \
    b[(k) + 1] = __builtin_shufflevector(a[k], a[(k) + 1], 2, 10, 3, 11, 6, 14, 7, 15)
    PAIR(0), PAIR(2), PAIR(4), PAIR(6);
#undef PAIR
#define FOUR(k)                                                                             \
    a[k] = __builtin_shufflevector(b[k], b[(k) + 2], 0, 1, 8, 9, 4, 5, 12, 13),             \
    a[(k) + 1] = __builtin_shufflevector(b[k], b[(k) + 2], 2, 3, 10, 11, 6, 7, 14, 15),     \
    a[(k) + 2] = __builtin_shufflevector(b[(k) + 1], b[(k) + 3], 0, 1, 8, 9, 4, 5, 12, 13), \
    a[(k) + 3] = __builtin_shufflevector(b[(k) + 1], b[(k) + 3], 2, 3, 10, 11, 6, 7, 14, 15)
    FOUR(0), FOUR(4);
#undef FOUR
#define HALVES(k)                                                                 \
    row[k] = __builtin_shufflevector(a[k], a[(k) + 4], 0, 1, 2, 3, 8, 9, 10, 11), \
    row[(k) + 4] = __builtin_shufflevector(a[k], a[(k) + 4], 4, 5, 6, 7, 12, 13, 14, 15)
    HALVES(0), HALVES(1), HALVES(2), HALVES(3);
#undef HALVES
}

// A block lies in a disc: the slab's part within the radius of the slab's axis. r: from the ball's centre to the
// block's.
HAPTICLOD_INLINE void disc_bound(const V8& r, const V8& normal, const F8& radius, const F8& half, F8& out) {
    const F8 zero = {0, 0, 0, 0, 0, 0, 0, 0};
    const F8 rr = V8_DOT(r, r);
    F8 h = V8_DOT(r, normal), aside = rr * 0.999998f - h * h;
    root(SELECT(aside > zero, aside, zero), aside);
    aside -= radius;
    aside = SELECT(aside > zero, aside, zero);
    h = SELECT(h > zero, h, -h) - half;
    h = SELECT(h > zero, h, zero);
    root(aside * aside + h * h, out);
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

HAPTICLOD_INLINE float least_of(const F8& v) {
    float least = v[0];
    for (int k = 1; k < 8; ++k) least = v[k] < least ? v[k] : least;
    return least;
}

HAPTICLOD_INLINE void planes_at(const EvalBlock& block, const float move[3], F8& out) {
    V8 n;
    F8 clearance;
    load(block.nx, n.x), load(block.ny, n.y), load(block.nz, n.z), load(block.clearance, clearance);
    out = n.x * move[0] + n.y * move[1] + n.z * move[2] + clearance;
}

}  // namespace

float eval(const TriBlock& block, const float shift[3], const float residual[3], float kept, EvalBlock& out) {
    V8 r;
    F8 r2, d;
    nearest(block.v, shift, residual, r, r2);
    const F8 zero = {0, 0, 0, 0, 0, 0, 0, 0};
    root(r2, d);
    const F8 inverse = 1.0f / SELECT(d > zero, d, zero + 1.0f);
    store(out.nx, r.x * inverse), store(out.ny, r.y * inverse), store(out.nz, r.z * inverse);
    d -= kept;
    store(out.clearance, d);
    return least_of(d);
}

float granted(const EvalBlock& block, const float move[3]) {
    F8 at;
    planes_at(block, move, at);
    return least_of(at);
}

std::uint32_t crossed(const EvalBlock& block, const float move[3], float margin) {
    F8 at;
    planes_at(block, move, at);
    return bits_of(at < margin);
}

void near(const BlockBound* bounds, std::uint32_t count, const BallPack& balls, const float centre[3],
          std::uint32_t active, float reach, float* least, float* low, std::uint32_t* bits) {
    V8 at;
    F8 kept, beyond;
    load(balls.x, at.x), load(balls.y, at.y), load(balls.z, at.z), load(balls.kept, kept), load(least, beyond);
    for (std::uint32_t b = 0; b < count; ++b) {
        const BlockBound& block = bounds[b];
        V8 r;
        r.x = (block.x - centre[0]) - at.x, r.y = (block.y - centre[1]) - at.y, r.z = (block.z - centre[2]) - at.z;
        V8 normal;
        const F8 zero = {0, 0, 0, 0, 0, 0, 0, 0};
        normal.x = zero + block.nx, normal.y = zero + block.ny, normal.z = zero + block.nz;
        F8 d;
        disc_bound(r, normal, zero + block.radius, zero + block.half, d);
        d -= kept;
        const I8 within = d <= reach;
        bits[b] = bits_of(within) & active;
        beyond = SELECT(~within & (d < beyond), d, beyond);
        store(low + 8 * b, d);
    }
    store(least, beyond);
}

void near_one(const BlockBound* bounds, std::uint32_t count, const float centre[3], float kept, float* low) {
    for (std::uint32_t b = 0; b < count; b += 8) {
        F8 row[8], d;
        transpose(bounds + b, row);
        V8 r, normal;
        r.x = row[0] - centre[0], r.y = row[1] - centre[1], r.z = row[2] - centre[2];
        normal.x = row[4], normal.y = row[5], normal.z = row[6];
        disc_bound(r, normal, row[3], row[7], d);
        store(low + b, d - kept);
    }
}

void highest(const BlockBound* bounds, std::uint32_t count, const float place[3], const float normal[3], float* high) {
    for (std::uint32_t b = 0; b < count; b += 8) {
        F8 row[8], lean;
        transpose(bounds + b, row);
        V8 r, m, d;
        r.x = row[0] - place[0], r.y = row[1] - place[1], r.z = row[2] - place[2];
        m.x = row[4], m.y = row[5], m.z = row[6];
        // The slab has two sides: the normal of the nearer one. |d| is not less than the sine of the angle.
        const F8 along = m.x * normal[0] + m.y * normal[1] + m.z * normal[2];
        const I8 turned = along < 0.0f;
        m.x = SELECT(turned, -m.x, m.x), m.y = SELECT(turned, -m.y, m.y), m.z = SELECT(turned, -m.z, m.z);
        d.x = m.x - normal[0], d.y = m.y - normal[1], d.z = m.z - normal[2];
        root(V8_DOT(d, d), lean);
        store(high + b, r.x * normal[0] + r.y * normal[1] + r.z * normal[2] + row[7] + row[3] * (lean + 1e-6f));
    }
}

void beside(const BlockBound* bounds, std::uint32_t count, const float from[3], const float along[3], float inverse2,
            float within, float* apart2, std::uint32_t* bits) {
    const F8 zero = {0, 0, 0, 0, 0, 0, 0, 0};
    for (std::uint32_t b = 0; b < count; b += 8) {
        F8 row[8];
        transpose(bounds + b, row);
        V8 q;
        q.x = row[0] - from[0], q.y = row[1] - from[1], q.z = row[2] - from[2];
        store(apart2 + b, V8_DOT(q, q));
        F8 t = (q.x * along[0] + q.y * along[1] + q.z * along[2]) * inverse2;
        t = SELECT(t > zero, t, zero);
        t = SELECT(t < 1.0f, t, zero + 1.0f);
        q.x -= along[0] * t, q.y -= along[1] * t, q.z -= along[2] * t;
        const F8 least = row[3] + within;
        bits[b / 8] = bits_of(V8_DOT(q, q) * 0.999998f <= least * least);
    }
}

std::uint32_t facing(const TriBlock& block, const float shift[3], const float residual[3], float* height2) {
    const F8 zero = {0, 0, 0, 0, 0, 0, 0, 0};
    V8 a, b, c, ab, ac, ap, n, ab_ap, ap_ac;
    corners(block.v, shift, residual, a, b, c);
    V8_SUB(ab, b, a), V8_SUB(ac, c, a), ap.x = -a.x, ap.y = -a.y, ap.z = -a.z;
    V8_CROSS(n, ab, ac);
    V8_CROSS(ab_ap, ab, ap), V8_CROSS(ap_ac, ap, ac);
    const F8 nn = V8_DOT(n, n), wc = V8_DOT(n, ab_ap), wb = V8_DOT(n, ap_ac), h = V8_DOT(n, ap);
    const I8 inside = (nn > zero) & (wb >= zero) & (wc >= zero) & (wb + wc <= nn);
    store(height2, h * h / SELECT(nn > zero, nn, zero + 1.0f));
    return bits_of(inside);
}

std::uint32_t above(const TriBlock& block, const float shift[3], const float residual[3], const float normal[3],
                    float margin) {
    V8 a, b, c;
    corners(block.v, shift, residual, a, b, c);
    const F8 at_a = a.x * normal[0] + a.y * normal[1] + a.z * normal[2];
    const F8 at_b = b.x * normal[0] + b.y * normal[1] + b.z * normal[2];
    const F8 at_c = c.x * normal[0] + c.y * normal[1] + c.z * normal[2];
    return bits_of((at_a > margin) | (at_b > margin) | (at_c > margin));
}

}  // namespace hapticlod::HAPTICLOD_KERNEL_SPACE
