/* Frames from the host as other kernels take them, and counts of bad pixels. The host's arrays begin at value
   `start` of the given buffers. A work-item has a run of RUN_PIXELS * LANES pixels of a row: on CPUs consecutive
   ones, on GPUs those that lie as far apart as there are runs, so that neighbors load neighbors. */

#include "frame.h"
#include "simd_rgb.h"

#define DEPTH_MOST 1e37f  /* beyond, squares and products overflow */
#define RUN_PIXELS 31  /* for each lane: a byte holds the count of 8 lanes */

/* The number of runs in a row of `width` pixels, for a single lane. */
INLINE int runs_of(const int width) { return (width + RUN_PIXELS - 1) / RUN_PIXELS; }

/* Pixel k * LANES of the run of this work-item, in its row. */
INLINE int run_x(const int width, const int k) {
    const int run = get_global_id(0);
    return LANES > 1 ? (run * RUN_PIXELS + k) * LANES : run + k * runs_of(width);
}

/* Counts those of the first `count` lanes for which a condition holds. */
INLINE int lanes_where(const Ints condition, const int count) {
    int number = 0;
    uchar lanes[LANES];
    store_bytes(to_bytes(condition ? (Ints)(1) : (Ints)(0)), 0, lanes);
    for (int k = 0; k < min(count, LANES); ++k) number += lanes[k];
    return number;
}

/* Counts of this work-item, into two planes of a texel for each run. */
INLINE void store_counts(const int width, const int height, const int first, const int second, __global uchar *counts) {
    const int runs = runs_of(width), place = get_global_id(1) * runs + get_global_id(0) * LANES;
    counts[place] = first;
    counts[runs * height + place] = second;
}

/* Values of the host's array, which holds halves or floats. */
INLINE float given_value(__global const float *given, const bool halves, const int i) {
    return halves ? vload_half(i, (__global const half *)given) : given[i];
}

#if LANES == 8
INLINE float4 given_4(__global const float *given, const bool halves, const int i) {
    return halves ? vload_half4(0, (__global const half *)given + i) : vload4(0, given + i);
}

/* Four texels with 0 in their fourth channels. */
INLINE float16 rgb_of(const float16 texels) {
    const int4 rgb = (int4)(-1, -1, -1, 0);
    return as_float16(as_int16(texels) & (int16)(rgb, rgb, rgb, rgb));
}

INLINE float16 given_16(__global const float *given, const bool halves, const int i) {
    return halves ? vload_half16(0, (__global const half *)given + i) : vload16(0, given + i);
}
#endif

/* LANES pixels from pixel i on, of which the image has `count` or more: RGB, and 0. */
INLINE void load_given(__global const float *given, const bool halves, const int channels, const int i, const int count,
                       Strip *s) {
#if LANES == 8
    if (count >= LANES && channels == 4) {
        s->part[0] = rgb_of(given_16(given, halves, 4 * i));
        s->part[1] = rgb_of(given_16(given, halves, 4 * i + 16));
        return;
    }
    if (count >= LANES) {  /* with the first value of the next pixel, but for the last one */
        const float4 a = given_4(given, halves, 3 * i), b = given_4(given, halves, 3 * i + 3),
                     c = given_4(given, halves, 3 * i + 6), d = given_4(given, halves, 3 * i + 9),
                     e = given_4(given, halves, 3 * i + 12), f = given_4(given, halves, 3 * i + 15),
                     g = given_4(given, halves, 3 * i + 18), h = given_4(given, halves, 3 * i + 20).yzww;
        s->part[0] = rgb_of((float16)(a, b, c, d));
        s->part[1] = rgb_of((float16)(e, f, g, h));
        return;
    }
#endif
    float texels[4 * LANES];
    for (int k = 0; k < LANES; ++k) {
        const int first = channels * (i + min(k, count - 1));
        for (int c = 0; c < 3; ++c) texels[4 * k + c] = given_value(given, halves, first + c);
        texels[4 * k + 3] = 0.0f;
    }
    for (int part = 0; part < PARTS; ++part) s->part[part] = reload_texels(part, texels);
}

/* NaN counts as 0; infinities and values beyond half are clamped. */
INLINE void take(__constant Frame *restrict frame, __global const float *given, const bool halves, const int channels,
                 __global half *color, __global uchar *bad_pixels) {
    const int width = frame->source_width, height = frame->source_height, y = get_global_id(1);
    if ((int)get_global_id(0) * LANES >= runs_of(width) || y >= height) return;
    int infinite = 0, clamped = 0;
    for (int k = 0; k < RUN_PIXELS; ++k) {
        const int x = run_x(width, k), count = width - x, i = y * width + x;
        if (count <= 0) break;
        Strip s;
        load_given(given, halves, channels, i, count, &s);
        bool good = true;
        for (int part = 0; part < PARTS; ++part) good &= ALL_TEXELS(fabs(s.part[part]) <= COLOR_MAX);
        if (!good) {
            Floats rgba[4];
            channels_of(&s, rgba);
            const Ints r = isfinite(rgba[0]), g = isfinite(rgba[1]), b = isfinite(rgba[2]);
            const Ints over = (r & (fabs(rgba[0]) > COLOR_MAX)) | (g & (fabs(rgba[1]) > COLOR_MAX))
                              | (b & (fabs(rgba[2]) > COLOR_MAX));
            infinite += min(count, LANES) - lanes_where(r & g & b, count);
            clamped += lanes_where(over, count);
            for (int part = 0; part < PARTS; ++part) s.part[part] = finite_texels(s.part[part]);
        }
        store_strip(s, count, color + 4 * i);
    }
    store_counts(width, height, infinite, clamped, bad_pixels);
}

WIDE __kernel void take_floats(__constant Frame *restrict frame, __global const float *given, const int start,
                               const int channels, __global half *color, __global uchar *bad_pixels) {
    take(frame, given + start, false, channels, color, bad_pixels);
}

WIDE __kernel void take_halves(__constant Frame *restrict frame, __global const half *given, const int start,
                               const int channels, __global half *color, __global uchar *bad_pixels) {
    take(frame, (__global const float *)(given + start), true, channels, color, bad_pixels);
}

/* Bad are depth that is NaN, not positive or denormal, and motion that is NaN or infinite. Finite depth beyond
   DEPTH_MOST becomes sky, and motion as long as the diagonal, which leads out of the image from everywhere, NaN.
   Input and output may be the same buffer. */
WIDE __kernel void take_geometry(__constant Frame *restrict frame, __global const float *given_depth,
                                 const int depth_start, __global const float *given_motion, const int motion_start,
                                 __global float *depth, __global float2 *motion, __global uchar *bad_pixels) {
    const int width = frame->source_width, height = frame->source_height, y = get_global_id(1);
    if ((int)get_global_id(0) * LANES >= runs_of(width) || y >= height) return;
    const float diagonal_squared = (float)width * (float)width + (float)height * (float)height;
    int bad_depth = 0, bad_motion = 0, far = 0, too_long = 0;
    for (int k = 0; k < RUN_PIXELS; ++k) {
        const int x = run_x(width, k), count = width - x, i = y * width + x;
        if (count <= 0) break;
        Floats motion_y;
        Floats z = load_some_floats(count, given_depth + depth_start + i);
        Floats motion_x = load_some_xy(count, (__global const float2 *)(given_motion + motion_start) + i, &motion_y);
        const Ints good_depth = z >= FLT_MIN, beyond = (z > DEPTH_MOST) & !isinf(z);
        const Ints good_motion = motion_x * motion_x + motion_y * motion_y < diagonal_squared;
        if (!ALL(good_depth)) {
            bad_depth += min(count, LANES) - lanes_where(good_depth, count);
            z = ((z >= 0.0f) & !good_depth) ? (Floats)(0.0f) : z;
        }
        if (ANY(beyond)) {
            far += lanes_where(beyond, count);
            z = beyond ? (Floats)(INFINITY) : z;
        }
        if (!ALL(good_motion)) {
            const Ints finite = isfinite(motion_x) & isfinite(motion_y), unwritten = finite & !good_motion;
            bad_motion += min(count, LANES) - lanes_where(finite, count);
            too_long += lanes_where(unwritten, count);
            motion_x = unwritten ? (Floats)(NAN) : motion_x;
            motion_y = unwritten ? (Floats)(NAN) : motion_y;
        }
        store_some_floats(z, count, depth + i);
        store_some_xy(motion_x, motion_y, count, motion + i);
    }
    store_counts(width, height, bad_depth, bad_motion, bad_pixels + 2 * runs_of(width) * height);
    store_counts(width, height, far, too_long, bad_pixels + 4 * runs_of(width) * height);
}
