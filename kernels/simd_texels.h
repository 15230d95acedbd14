/* LANES texels of half images at once, wherever they lie, and cubic interpolation at LANES places (upscaling.cl). */

#include "simd_rgb.h"
#include "cubic.h"

/* Four channels of each lane. */
typedef struct {
    Floats x, y, z, w;
} Wide4;

/* float4 of each lane, as they lie in memory -> channels, and back into the first `count` pixels of a row. */
INLINE Wide4 channels_in(const float *texels) {
    Strip s;
    Floats c[4];
    for (int part = 0; part < PARTS; ++part) s.part[part] = reload_texels(part, texels);
    channels_of(&s, c);
    const Wide4 channels = {c[0], c[1], c[2], c[3]};
    return channels;
}

INLINE void store_channels(const Wide4 c, const int count, __global half *image) {
    store_strip(strip_of(c.x, c.y, c.z, c.w), count, image);
}

/* The four channels of the pixels i. */
INLINE Wide4 gather_channels(__global const half *image, const Ints i) {
    Strip s;
#if LANES == 8
    __global const ulong *texels = (__global const ulong *)image;  /* a texel each */
    const ulong4 left = (ulong4)(texels[i.s0], texels[i.s1], texels[i.s2], texels[i.s3]);
    const ulong4 right = (ulong4)(texels[i.s4], texels[i.s5], texels[i.s6], texels[i.s7]);
    s.part[0] = vload_half16(0, (const half *)&left);
    s.part[1] = vload_half16(0, (const half *)&right);
#else
    s.part[0] = load_texel(i, image);
#endif
    Floats c[4];
    channels_of(&s, c);
    const Wide4 channels = {c[0], c[1], c[2], c[3]};
    return channels;
}

/* The x and y of float2 that lie at i. */
INLINE Floats gather_xy(__global const float2 *p, const Ints i, Floats *y) {
#if LANES == 8
    const float16 xy = (float16)(p[i.s0], p[i.s1], p[i.s2], p[i.s3], p[i.s4], p[i.s5], p[i.s6], p[i.s7]);
    *y = xy.odd;
    return xy.even;
#else
    *y = p[i].y;
    return p[i].x;
#endif
}

/* Texels x to x + 3 of a row; beyond the image its border is repeated. */
INLINE float16 four_texels(__global const half *image, const int x, const int y, const int width, const int height) {
    const int row = clamp(y, 0, height - 1) * width;
    if (x >= 0 && x + 4 <= width) return load_four_texels(row + x, image);
    return (float16)(load_texel(row + clamp(x, 0, width - 1), image),
                     load_texel(row + clamp(x + 1, 0, width - 1), image),
                     load_texel(row + clamp(x + 2, 0, width - 1), image),
                     load_texel(row + clamp(x + 3, 0, width - 1), image));
}

/* Two of them. */
INLINE float8 two_texels(__global const half *image, const int x, const int y, const int width, const int height) {
    const int row = clamp(y, 0, height - 1) * width;
    if (x >= 0 && x + 2 <= width) return load_two_texels(row + x, image);
    return (float8)(load_texel(row + clamp(x, 0, width - 1), image),
                    load_texel(row + clamp(x + 1, 0, width - 1), image));
}

/* Cubic of the 4x4 taps from (x, y) on, but for the corners, which weigh little; clamped to the four inner ones. */
INLINE float4 clamped_cubic(const int x, const int y, const float4 wx, const float4 wy, const int width,
                            const int height, __global const half *image) {
    const int rows[4] = {clamp(y, 0, height - 1) * width, clamp(y + 1, 0, height - 1) * width,
                         clamp(y + 2, 0, height - 1) * width, clamp(y + 3, 0, height - 1) * width};
    const float4 row_weights[4] = {(float4)(wy.x), (float4)(wy.y), (float4)(wy.z), (float4)(wy.w)};
    CubicSums s;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        const int column = clamp(x + tx, 0, width - 1);
        const float4 b = load_texel(rows[1] + column, image), c = load_texel(rows[2] + column, image);
        const bool inner = tx == 1 || tx == 2;
        const float4 a = inner ? load_texel(rows[0] + column, image) : b,
                     d = inner ? load_texel(rows[3] + column, image) : c;
        add_column(tx, a, b, c, d, (float4)(component_of(wx, tx)), row_weights, &s);
    }
    return sums_up(s, (float4)(0.0f), NOT_STEEPER);
}

/* The image at LANES places of the lanes in `use` (others: 0), cubic without corners, clamped to the four inner
   taps. Of finite numbers. */
INLINE Wide4 cubic_at(const Ints use, const Floats px_x, const Floats px_y, const int width, const int height,
                      const float slope, __global const half *image) {
    const Floats corner_x = (use ? px_x : (Floats)(0.5f)) - 0.5f, corner_y = (use ? px_y : (Floats)(0.5f)) - 0.5f;
    const Floats first_x = floor(corner_x), first_y = floor(corner_y);
    const Ints x = to_ints(first_x) - 1, y = to_ints(first_y) - 1;
    Floats wx[4], wy[4];
    wide_cubic_weights(corner_x - first_x, slope, wx);
    wide_cubic_weights(corner_y - first_y, slope, wy);
    wide_without_corners(wx, wy);
    int lane_use[LANES], lane_x[LANES], lane_y[LANES];
    float texels[4 * LANES], lanes_x[4][LANES], lanes_y[4][LANES];
    store_ints(x, 0, lane_x);
    store_ints(y, 0, lane_y);
    if (!ALL(use))
        for (int k = 0; k < LANES; ++k) vstore4((float4)(0.0f), k, texels);
    Ints rest = use;
#if LANES == 8
    /* Halves whose taps lie in a row, within the image. */
    const Ints in_row = use & (x - LANE_NUMBERS == (int8)((int4)(lane_x[0]), (int4)(lane_x[4] - 4)))
                        & (y == (int8)((int4)(lane_y[0]), (int4)(lane_y[4]))) & (x >= 0) & (y >= 0) & (x + 4 <= width)
                        & (y + 4 <= height);
    for (int k = 0; k < 2; ++k) {
        if (!all(k ? in_row.hi : in_row.lo)) continue;
        const float4 four_x[4] = {k ? wx[0].hi : wx[0].lo, k ? wx[1].hi : wx[1].lo, k ? wx[2].hi : wx[2].lo,
                                  k ? wx[3].hi : wx[3].lo};
        const float4 four_y[4] = {k ? wy[0].hi : wy[0].lo, k ? wy[1].hi : wy[1].lo, k ? wy[2].hi : wy[2].lo,
                                  k ? wy[3].hi : wy[3].lo};
        unload_texels(cubic_of_run(lane_y[4 * k] * width + lane_x[4 * k], four_x, four_y, width, image, (float4)(0.0f),
                                   NOT_STEEPER),
                      k, texels);
        if (k)
            rest.hi = (int4)(0);
        else
            rest.lo = (int4)(0);
    }
    if (!any(rest)) return channels_in(texels);
#endif
    store_ints(rest, 0, lane_use);
    for (int k = 0; k < 4; ++k) {
        store_floats(wx[k], 0, lanes_x[k]);
        store_floats(wy[k], 0, lanes_y[k]);
    }
    for (int k = 0; k < LANES; ++k)
        if (lane_use[k])
            vstore4(clamped_cubic(
                        lane_x[k], lane_y[k], (float4)(lanes_x[0][k], lanes_x[1][k], lanes_x[2][k], lanes_x[3][k]),
                        (float4)(lanes_y[0][k], lanes_y[1][k], lanes_y[2][k], lanes_y[3][k]), width, height, image),
                    k, texels);
    return channels_in(texels);
}
