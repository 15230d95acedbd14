/* Shared by all kernels. Conventions: row-major images, origin top left, y down; the center of pixel (i, j) is
   (i + 0.5, j + 0.5); depth is planar view-space z, +inf for sky; half is storage, never arithmetic. */

#pragma OPENCL FP_CONTRACT OFF

/* Before a kernel in which few work-items do anything: it stays scalar on CPUs, whose vectorizers else make all
   lanes walk the rare path. */
#define SPARSE __attribute__((vec_type_hint(float4)))

/* Before every helper function. Without `static`, C99 has no definition for calls that a compiler leaves, and the
   linkers of AMD and NVIDIA refuse the program. Calls that are left break the vectorizer of Intel's CPU runtime.
   With several lanes, Oclgrind does not know an intrinsic (llvm.experimental.noalias.scope.decl) that is left where a
   `Strip` is returned by an inlined function. */
#ifdef OCLGRIND
#define INLINE static __attribute__((noinline))
#else
#define INLINE static inline __attribute__((always_inline))
#endif

/* In the programs of kernels/stories/, which define STORY, functions note in `told` of a struct what they decide by,
   for the story of a pixel. Nothing of it is left in others. */
#ifdef STORY
#define TOLD __global float *told;
#define TELL(of, what, value) (of).told[what] = (float)(value)
#else
#define TOLD
#define TELL(of, what, value)
#endif

#define INVALID_DEPTH(z) (!((z) > 0.0f))  /* NaN, zero, negative */
#define COLOR_MAX 65504.0f

/* Bits of `links`: which neighbors of a pixel are of the same surface. */
#define LINK_RIGHT 1
#define LINK_DOWN 2
#define LINK_LEFT 4
#define LINK_UP 8
#define ALL_LINKS 15
#define IN_LATTICE 16 /* beside them: the pixel goes where its block's layer goes (lattices.h) */

/* Values of `filled_by`, the source of a pixel of an extrapolated frame; 1 + l is level l of the background. */
#define BY_WARP 0
#define BY_HIDDEN_PART 250
#define BY_FIXED 251
#define BY_REAPPEARING 252
#define BY_NOTHING 253
#define BY_CRACK_CLOSING 254
#define BY_HOLE_FILLING 255
#define IS_OF_MOVER(label) ((label) == BY_HIDDEN_PART || (label) == BY_REAPPEARING)

/* Pinhole intrinsics in pixels: (fx, fy, cx, cy). */
typedef float4 Pinhole;

/* View space of a source camera -> view space of a target camera, with both projections. Rows of a rigid 3x4. */
typedef struct {
    float4 row0, row1, row2;
    float4 source;          /* fx, fy, cx, cy */
    float4 source_inverse;  /* 1/fx, 1/fy, cx, cy */
    float4 target;          /* fx, fy, cx, cy */
} Reprojection;

/* a / b, correctly rounded but for one case in millions, from a division that is good to a few ulp:
   the remainder a - q b is computed exactly (Dekker's product) and its quotient added.
   Plain division where a magnitude would leave the range in which that is exact, and on devices that divide exactly.
   DEFINE_DIVIDE defines `divide` for numbers F: float here, Floats in simd.h. DEFINE_ROOT defines `root`, the square
   root, in the same way: devices that divide exactly have exact roots. */
#ifdef EXACT_DIVISION
#define DEFINE_ROOT(F, root)                                                                                           \
    INLINE F root(const F x) { return sqrt(x); }
#define DEFINE_DIVIDE(F, divide)                                                                                       \
    INLINE F divide(const F a, const F b) { return a / b; }
#else
#define DEFINE_ROOT(F, root)                                                                                           \
    INLINE F root(const F x) {                                                                                         \
        const F r = sqrt(x), r_c = r * 4097.0f, r_hi = r_c - (r_c - r), r_lo = r - r_hi, square = r * r;               \
        const F error = ((r_hi * r_hi - square) + 2.0f * (r_hi * r_lo)) + r_lo * r_lo;                                 \
        const F remainder = (x - square) - error;                                                                      \
        return ((x > 1e-15f) & (x < 1e15f)) ? r + 0.5f * remainder / r : r;                                            \
    }
#define DEFINE_DIVIDE(F, divide)                                                                                       \
    INLINE F divide(const F a, const F b) {                                                                            \
        const F q = a / b, size = fabs(q), size_b = fabs(b);                                                           \
        const F q_c = q * 4097.0f, b_c = b * 4097.0f;                                                                  \
        const F q_hi = q_c - (q_c - q), b_hi = b_c - (b_c - b);                                                        \
        const F q_lo = q - q_hi, b_lo = b - b_hi;                                                                      \
        const F product = q * b;                                                                                       \
        const F error = ((q_hi * b_hi - product) + q_hi * b_lo + q_lo * b_hi) + q_lo * b_lo;                           \
        const F remainder = (a - product) - error;                                                                     \
        return ((size > 1e-15f) & (size < 1e15f) & (size_b > 1e-15f) & (size_b < 1e15f)) ? q + remainder / b : q;      \
    }
#endif

DEFINE_DIVIDE(float, divide)

INLINE float2 pixel_center(const int x, const int y) { return (float2)((float)x + 0.5f, (float)y + 0.5f); }

INLINE bool inside(const int x, const int y, const int width, const int height) {
    return x >= 0 && y >= 0 && x < width && y < height;
}

/* Whether a pixel, in floats that may be too large for integers, lies in the image. */
INLINE bool holds(const int width, const int height, const float2 px) {
    return px.x >= 0.0f && px.y >= 0.0f && px.x < (float)width && px.y < (float)height;
}

/* Whether a reprojected position lies in the image, before its camera. */
INLINE bool lands(const float3 px, const int width, const int height) {
    return px.z > 0.0f && holds(width, height, px.xy);
}

/* Pixel position and depth -> view space. For sky (z = inf) the direction with z = 1. */
INLINE float3 unproject(const float2 px, const float z, const Pinhole inverse) {
    const float scale = isinf(z) ? 1.0f : z;
    return (float3)((px.x - inverse.z) * inverse.x * scale, (px.y - inverse.w) * inverse.y * scale, scale);
}

/* The dot product, in the same order of additions on every device. */
INLINE float product_of(const float3 a, const float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

INLINE float squared_length(const float3 v) { return product_of(v, v); }

INLINE float3 rotate_to_target(const float3 v, const Reprojection r) {
    return (float3)(r.row0.x * v.x + r.row0.y * v.y + r.row0.z * v.z, r.row1.x * v.x + r.row1.y * v.y + r.row1.z * v.z,
                    r.row2.x * v.x + r.row2.y * v.y + r.row2.z * v.z);
}

INLINE float3 move_to_target(const float3 v, const Reprojection r) {
    const float3 rotated = rotate_to_target(v, r);
    return (float3)(rotated.x + r.row0.w, rotated.y + r.row1.w, rotated.z + r.row2.w);
}

/* View space -> pixel position; z must be > 0. */
INLINE float2 project(const float3 v, const Pinhole camera) {
    return (float2)(divide(camera.x * v.x, v.z) + camera.z, divide(camera.y * v.y, v.z) + camera.w);
}

/* Source pixel position and depth -> (target px, target z). Sky turns but does not move: z stays inf.
   z <= 0 in the result: behind the target camera, px undefined. */
INLINE float3 reproject(const float2 px, const float z, const Reprojection r) {
    const float3 view_pos = unproject(px, z, r.source_inverse);
    const bool sky = isinf(z);
    const float3 target_pos = sky ? rotate_to_target(view_pos, r) : move_to_target(view_pos, r);
    if (!(target_pos.z > 0.0f)) return (float3)(0.0f, 0.0f, -1.0f);
    return (float3)(project(target_pos, r.target), sky ? INFINITY : target_pos.z);
}

/* Weight of one of the four taps of bilinear interpolation, bit 0: right, bit 1: down, at (u, v) from the first. */
INLINE float bilinear_weight(const int tap, const float u, const float v) {
    return ((tap & 1) ? u : 1.0f - u) * ((tap >> 1) ? v : 1.0f - v);
}

/* Whether depth z is that of a surface at depth `expected`, within `tolerance`; sky is sky only. */
INLINE bool is_same_surface(const float z, const float expected, const float tolerance) {
    return isinf(expected) ? isinf(z) : fabs(z - expected) <= tolerance;
}

/* The mean of a weighted sum. */
INLINE float3 mean_of(const float3 sum, const float weight_sum) {
    return (float3)(divide(sum.x, weight_sum), divide(sum.y, weight_sum), divide(sum.z, weight_sum));
}

/* Colors as they are read and stored: NaN counts as 0, and magnitudes are limited to the largest half. */
#define DEFINE_FINITE(F, finite)                                                                                       \
    INLINE F finite(const F c) {                                                                                       \
        const F number = c == c ? c : (F)(0.0f), low = number < -COLOR_MAX ? (F)(-COLOR_MAX) : number;                 \
        return low < COLOR_MAX ? low : (F)(COLOR_MAX);                                                                 \
    }

DEFINE_FINITE(float4, finite_texel)

/* Texel i of an image of four halves each. It is read and written as a whole: vload_half4 may count on the alignment of
   one half only, so that GPUs take four loads for it. */
INLINE float4 load_texel(const int i, __global const half *image) {
    const ulong texel = ((__global const ulong *)image)[i];
    return vload_half4(0, (const half *)&texel);
}

/* Linear RGB of pixel i. */
INLINE float3 load_color(__global const half *color, const int i) { return finite_texel(load_texel(i, color)).xyz; }

/* Every image of colors is stored by these two, and by store_texels of simd_rgb.h. */
INLINE void store_texel(const float4 c, const int i, __global half *color) {
    ulong texel;
    vstore_half4_rte(finite_texel(c), 0, (half *)&texel);
    ((__global ulong *)color)[i] = texel;
}

INLINE void store_color(const float3 c, __global half *color, const int i) { store_texel((float4)(c, 0.0f), i, color); }
