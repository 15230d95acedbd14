/* Colors of half images, LANES pixels at once, unchecked: finite_rgb replaces NaN and infinity. */

#include "simd.h"

/* Channels of LANES pixels, apart. Loops over them are unrolled: Oclgrind cannot build others. */
typedef struct {
    Floats c[4];
} Wide4;

DEFINE_FINITE(Floats, finite)

INLINE Wide4 finite_rgb(Wide4 color) {
#pragma unroll
    for (int k = 0; k < 3; ++k) color.c[k] = finite(color.c[k]);
    return color;
}

#if LANES == 8

INLINE void copy_rgb_run(__global const half *color, __global half *out) {
    vstore16(vload16(0, (__global const uint *)color), 0, (__global uint *)out);
}

/* All channels of some pixels that follow one another, as they lie in memory: of a strip of LANES pixels in PARTS. */
typedef float16 Texels;
#define TEXELS 4
#define PARTS 2
#define VALID(texels) (texels).s37bf  /* the fourth channel */
#define OF_TEXELS(v, part)                                                                                             \
    ((part) ? (v).hi.s0000111122223333 : (v).lo.s0000111122223333)  /* a number of each pixel for its channels */
#define ANY_TEXELS(condition) any_of_lanes((condition).lo | (condition).hi)
#define ALL_TEXELS(condition) all_of_lanes((condition).lo &(condition).hi)
#define load_texels(i, p) load_four_texels(4 * (i), p)
#define reload_texels(i, p) vload16(i, p)
#define unload_texels(v, i, p) vstore16(v, i, p)
#define load_loose_texels(p) load_halfs16(p) /* of halves that may not be aligned */
#define to_texels convert_float16
#define THREE_TO_FOUR(v) ((v).s0120345067809ab0) /* three numbers after the other, each as a texel */
/* Whether a condition holds for all lanes of a part; the pixels that would follow each part's first one in a row. */
#define ALL_OF_PART(condition, part) all_of_half((part) ? (condition).hi : (condition).lo)
#define ROWS_OF_PARTS(pixels) ((int8)((int4)((pixels).s0), (int4)((pixels).s4 - 4)) + LANE_NUMBERS)

DEFINE_FINITE(Texels, finite_texels)

INLINE bool all_of_half(const int4 condition) { return as_uint(convert_char4(condition)) == ~0U; }

INLINE void store_texels(const Texels c, const int i, __global half *color) {
    vstore_half16_rte(finite_texels(c), i, color);
}

/* The texels of a part of LANES pixels anywhere, which may lie `in_row`. */
INLINE Texels gather_texels(__global const half *image, const Ints i, const int part, const bool in_row) {
    __global const ulong *texels = (__global const ulong *)image;
    const int4 at = part ? i.hi : i.lo;
    const ulong4 four =
        in_row ? vload4(0, texels + at.x) : (ulong4)(texels[at.x], texels[at.y], texels[at.z], texels[at.w]);
    return (float16)(vload_half8(0, (const half *)&four), vload_half8(1, (const half *)&four));
}

#else

INLINE void copy_rgb_run(__global const half *color, __global half *out) {
    *(__global uint2 *)out = *(__global const uint2 *)color;
}

typedef float4 Texels;
#define TEXELS 1
#define PARTS 1
#define VALID(texels) (texels).w
#define OF_TEXELS(v, part) ((void)(part), (float4)(v))
#define ANY_TEXELS(condition) any(condition)
#define ALL_TEXELS(condition) all(condition)
#define load_texels(i, p) load_texel(i, p)
#define reload_texels(i, p) vload4(i, p)
#define unload_texels(v, i, p) vstore4(v, i, p)
#define load_loose_texels(p) vload_half4(0, p)
#define to_texels convert_float4
#define THREE_TO_FOUR(v) (v)
#define ALL_OF_PART(condition, part) ((condition) != 0)
#define ROWS_OF_PARTS(pixels) (pixels)
#define finite_texels finite_texel
#define store_texels store_texel
#define gather_texels(image, i, part, in_row) ((void)(part), (void)(in_row), load_texel(i, image))

#endif

typedef struct {
    Texels part[PARTS];
} Strip;

INLINE Wide4 channels_of(const Strip *s) {
#if LANES == 8
    const Wide4 channels = {{(float8)(s->part[0].s048c, s->part[1].s048c), (float8)(s->part[0].s159d, s->part[1].s159d),
                             (float8)(s->part[0].s26ae, s->part[1].s26ae),
                             (float8)(s->part[0].s37bf, s->part[1].s37bf)}};
#else
    const Wide4 channels = {{s->part[0].x, s->part[0].y, s->part[0].z, s->part[0].w}};
#endif
    return channels;
}

INLINE Strip strip_of(const Wide4 channels) {
    const Floats x = channels.c[0], y = channels.c[1], z = channels.c[2], w = channels.c[3];
    Strip s;
#if LANES == 8
    s.part[0] =
        (float16)(x.s0, y.s0, z.s0, w.s0, x.s1, y.s1, z.s1, w.s1, x.s2, y.s2, z.s2, w.s2, x.s3, y.s3, z.s3, w.s3);
    s.part[1] =
        (float16)(x.s4, y.s4, z.s4, w.s4, x.s5, y.s5, z.s5, w.s5, x.s6, y.s6, z.s6, w.s6, x.s7, y.s7, z.s7, w.s7);
#else
    s.part[0] = (float4)(x, y, z, w);
#endif
    return s;
}

INLINE void gather_strip(__global const half *image, const Ints i, Strip *s) {
#pragma unroll
    for (int part = 0; part < PARTS; ++part) s->part[part] = gather_texels(image, i, part, false);
}

/* The four channels of the pixels i. */
INLINE Wide4 gather_channels(__global const half *image, const Ints i) {
    Strip s;
    gather_strip(image, i, &s);
    return channels_of(&s);
}

/* The first `count` of LANES pixels, or all if it is more, as for load_some_floats of simd.h. */
INLINE Strip load_strip(const int count, __global const half *color) {
    Strip s;
    if (IS_WHOLE(count)) {
        for (int part = 0; part < PARTS; ++part) s.part[part] = load_texels(part, color);
        return s;
    }
    float texels[4 * LANES];
    for (int k = 0; k < LANES; ++k) vstore4(load_texel(min(k, count - 1), color), k, texels);
    for (int part = 0; part < PARTS; ++part) s.part[part] = reload_texels(part, texels);
    return s;
}

INLINE void store_strip(const Strip s, const int count, __global half *color) {
    if (IS_WHOLE(count)) {
        for (int part = 0; part < PARTS; ++part) store_texels(s.part[part], part, color);
        return;
    }
    float texels[4 * LANES];
    for (int part = 0; part < PARTS; ++part) unload_texels(s.part[part], part, texels);
    for (int k = 0; k < count; ++k) store_texel(vload4(k, texels), k, color);
}

INLINE Wide4 load_some_channels(const int count, __global const half *image) {
    const Strip s = load_strip(count, image);
    return channels_of(&s);
}

INLINE void store_channels(const Wide4 c, const int count, __global half *image) {
    store_strip(strip_of(c), count, image);
}
