/* Frames from the host, or in an engine's own formats, as other kernels take them, and counts of bad pixels. Arrays
   begin at value `start` of the given buffers. "Geometry" is depth and motion, which may be smaller than color. A
   work-item has a run of RUN_PIXELS * LANES pixels of a row: on CPUs consecutive ones, on GPUs those that lie as far
   apart as there are runs, so that neighbors load neighbors. No other kernel knows about formats
   (gffe_cl/engine/frame/frame_format.py). */

#include "frame.h"
#include "stencil.h"
#include "logarithm.h"
#include "thresholds.h"

/* What set the thresholds: docs/deviations.md, "Dilated vectors are undone", "Depth and motion may be smaller than
   color". */
#define DEPTH_MOST 1e37f  /* beyond, squares and products overflow */
#define RUN_PIXELS 31  /* for each lane: a byte holds the count of 8 lanes */

/* Of sRGB: values up to the toe are linear. */
#define SRGB_TOE 0.04045f
#define SRGB_LEAST 0.09f /* (toe + .055) / 1.055, rounded down */

/* Of dilated motion. */
#define SQUARE 5      /* samples, the side of the square that is looked at */
#define MIDDLE (SQUARE * SQUARE / 2)

/* Of geometry that is smaller than color. */
#define ALIKE_MOTION 4.0f  /* pixels of color, each way */
#define NEARNESS 0.05f  /* what a sample's distance counts for, beside the difference of its color */

/* Types of given values. Integers stand for 0 to 1, or -1 to 1 (SNORM16); UNORM24 are the low bits of 32. */
enum { NO_BUFFER, FLOAT32, FLOAT16, UNORM8, UNORM16, SNORM16, UNORM24 };

/* What is linear in given depth: planar depth, 1 / depth of a depth buffer, the logarithm, or the distance. */
enum { DEPTH_LINEAR, DEPTH_DEVICE, DEPTH_LOGARITHMIC, DEPTH_DISTANCE };
#define MOST_POWER 87.0f /* of e, in a float */

/* What given motion vectors have of the camera's motion. */
enum { CAMERA_INCLUDED, CAMERA_MOVERS_ONLY, CAMERA_EXCLUDED };

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
    for (int k = 0; k < min(count, LANES); ++k) number += int_of(&condition, k) != 0;
    return number;
}

/* Counts of this work-item, into two planes from `plane` on of a texel for each run of an image of this size. */
INLINE void store_counts(const int width, const int height, const int plane, const int first, const int second,
                         __global uchar *counts) {
    const int runs = runs_of(width), place = (plane * height + get_global_id(1)) * runs + get_global_id(0) * LANES;
    counts[place] = first;
    counts[runs * height + place] = second;
}

/* Row of a given buffer of `height` rows that holds row y, counted down. */
INLINE int given_row(const bool rows_up, const int height, const int y) { return rows_up ? height - 1 - y : y; }

/* The buffer from its value `start` on. */
INLINE __global const float *given_from(__global const uchar *given, const int type, const int start) {
    const int bytes = type == UNORM8 ? 1 : (type == FLOAT32 || type == UNORM24) ? 4 : 2;
    return (__global const float *)(given + (size_t)bytes * start);
}

/* Value i as it is stored: integers are not scaled. */
INLINE float stored_value(__global const float *given, const int type, const int i) {
    switch (type) {
    case FLOAT16:
        return vload_half(i, (__global const half *)given);
    case UNORM8:
        return (float)((__global const uchar *)given)[i];
    case UNORM16:
        return (float)((__global const ushort *)given)[i];
    case SNORM16:
        return (float)((__global const short *)given)[i];
    case UNORM24:
        return (float)(((__global const uint *)given)[i] & 0xffffff);
    default:
        return given[i];
    }
}

/* What a stored color value is multiplied with. */
INLINE float color_unit(const int type) {
    return type == UNORM8 ? 1.0f / 255.0f : type == UNORM16 ? 1.0f / 65535.0f : 1.0f;
}

/* Values from value i on, as many as the texels of a part have. */
INLINE Texels given_texels(__global const float *given, const int type, const int i) {
    switch (type) {
    case FLOAT16:
        return load_loose_texels((__global const half *)given + i);
    case UNORM8:
        return to_texels(reload_texels(0, (__global const uchar *)given + i)) * color_unit(type);
    case UNORM16:
        return to_texels(reload_texels(0, (__global const ushort *)given + i)) * color_unit(type);
    default:
        return reload_texels(0, given + i);
    }
}

/* LANES pixels from pixel i on, of which the image has `count` or more: RGB, and 0. */
INLINE void load_given(__global const float *given, const int type, const int channels, const int i, const int count,
                       Strip *s) {
    const bool read_beyond = channels == 3; /* a third of the texels of a part */
    if (read_beyond ? LANES > 1 && count >= LANES + 2 : IS_WHOLE(count)) {
#pragma unroll
        for (int part = 0; part < PARTS; ++part) {
            const Texels values = given_texels(given, type, channels * (i + part * TEXELS));
            s->part[part] = read_beyond ? THREE_TO_FOUR(values) : values;
            VALID(s->part[part]) = 0.0f;
        }
        return;
    }
    float texels[4 * LANES];
    for (int k = 0; k < LANES; ++k) {
        const int first = channels * (i + min(k, count - 1));
        for (int c = 0; c < 3; ++c) texels[4 * k + c] = stored_value(given, type, first + c) * color_unit(type);
        texels[4 * k + 3] = 0.0f;
    }
    for (int part = 0; part < PARTS; ++part) s->part[part] = reload_texels(part, texels);
}

/* Linear light of sRGB (IEC 61966-2-1), without an upper limit. */
INLINE Floats linear_of_srgb(const Floats c) {
    const Floats lifted = (c + 0.055f) * (1.0f / 1.055f), low = lifted > SRGB_LEAST ? lifted : (Floats)(SRGB_LEAST);
    const Floats power = 2.4f * log_of(low > COLOR_MAX ? (Floats)(COLOR_MAX) : low);
    const Floats curve = exp_less_one(power) + 1.0f;
    return c <= SRGB_TOE ? c * (1.0f / 12.92f) : isfinite(c) ? curve : c;
}

/* NaN counts as 0; infinities and values beyond half are clamped. */
INLINE void take(const int width, const int height, __global const float *given, const int type, const int channels,
                 const bool rows_up, const bool is_srgb, __global half *color, __global uchar *bad_pixels) {
    const int y = get_global_id(1), row = given_row(rows_up, height, y);
    if ((int)get_global_id(0) * LANES >= runs_of(width) || y >= height) return;
    int infinite = 0, clamped = 0;
    for (int k = 0; k < RUN_PIXELS; ++k) {
        const int x = run_x(width, k), count = width - x, i = y * width + x;
        if (count <= 0) break;
        Strip s;
        load_given(given, type, channels, row * width + x, count, &s);
        if (is_srgb) {
            Wide4 rgb = channels_of(&s);
            for (int c = 0; c < 3; ++c) rgb.c[c] = linear_of_srgb(rgb.c[c]);
            s = strip_of(rgb);
        }
        bool good = true;
        for (int part = 0; part < PARTS; ++part) good &= ALL_TEXELS(fabs(s.part[part]) <= COLOR_MAX);
        if (!good) {
            const Wide4 rgb = channels_of(&s);
            Ints all_finite = ALL_LANES, over = 0;
            for (int c = 0; c < 3; ++c) {
                all_finite &= isfinite(rgb.c[c]);
                over |= isfinite(rgb.c[c]) & (fabs(rgb.c[c]) > COLOR_MAX);
            }
            infinite += min(count, LANES) - lanes_where(all_finite, count);
            clamped += lanes_where(over, count);
        }
        store_strip(s, count, color + 4 * i);
    }
    store_counts(width, height, 0, infinite, clamped, bad_pixels);
}

/* Floats or halves. */
WIDE __kernel void take_color(const int width, const int height, __global const uchar *given, const int start,
                              const int type, const int channels, __global half *color, __global uchar *bad_pixels) {
    take(width, height, given_from(given, type, start), type == FLOAT32 ? FLOAT32 : FLOAT16, channels, false, false,
         color, bad_pixels);
}

/* Color of any type that a description allows, on its way from host or device. */
WIDE __kernel void convert_color(__constant Frame *restrict frame, __global const uchar *given, const int start,
                                 __global half *color, __global uchar *bad_pixels) {
    const int type = frame->given_types.x;
    take(frame->source_width, frame->source_height, given_from(given, type, start), type, frame->given_channels.x,
         frame->rows_up, frame->color_srgb, color, bad_pixels);
}

/* Bad is depth that is NaN, not positive or denormal. Finite depth beyond DEPTH_MOST becomes sky. */
INLINE Floats checked_depth(Floats z, const int count, int *bad, int *far) {
    const Ints good = z >= FLT_MIN, beyond = (z > DEPTH_MOST) & !isinf(z);
    if (!ALL(good)) {
        *bad += min(count, LANES) - lanes_where(good, count);
        z = ((z >= 0.0f) & !good) ? (Floats)(0.0f) : z;
    }
    if (ANY(beyond)) {
        *far += lanes_where(beyond, count);
        z = beyond ? (Floats)(INFINITY) : z;
    }
    return z;
}

/* Bad is motion that is NaN or infinite. Motion as long as the diagonal, which leads out of the image from everywhere,
   becomes NaN. */
INLINE void check_motion(Floats *x, Floats *y, const int count, const float diagonal_squared, int *bad, int *too_long) {
    const Ints good = *x * *x + *y * *y < diagonal_squared;
    if (!ALL(good)) {
        const Ints is_finite = isfinite(*x) & isfinite(*y), unwritten = is_finite & !good;
        *bad += min(count, LANES) - lanes_where(is_finite, count);
        *too_long += lanes_where(unwritten, count);
        *x = unwritten ? (Floats)(NAN) : *x;
        *y = unwritten ? (Floats)(NAN) : *y;
    }
}

INLINE float diagonal_squared_of(const float width, const float height) { return width * width + height * height; }

/* Input and output may be the same buffer. */
WIDE __kernel void take_geometry(const int width, const int height, __global const float *given_depth,
                                 const int depth_start, __global const float *given_motion, const int motion_start,
                                 __global float *depth, __global float2 *motion, __global uchar *bad_pixels) {
    const int y = get_global_id(1);
    if ((int)get_global_id(0) * LANES >= runs_of(width) || y >= height) return;
    const float diagonal_squared = diagonal_squared_of(width, height);
    int bad_depth = 0, bad_motion = 0, far = 0, too_long = 0;
    for (int k = 0; k < RUN_PIXELS; ++k) {
        const int x = run_x(width, k), count = width - x, i = y * width + x;
        if (count <= 0) break;
        Floats motion_y;
        const Floats z = load_some_floats(count, given_depth + depth_start + i);
        Floats motion_x = load_some_xy(count, (__global const float2 *)(given_motion + motion_start) + i, &motion_y);
        store_some_floats(checked_depth(z, count, &bad_depth, &far), count, depth + i);
        check_motion(&motion_x, &motion_y, count, diagonal_squared, &bad_motion, &too_long);
        store_some_xy(motion_x, motion_y, count, motion + i);
    }
    store_counts(width, height, 2, bad_depth, bad_motion, bad_pixels);
    store_counts(width, height, 4, far, too_long, bad_pixels);
}

/* Values i, i + step ... as they are stored, for the first `count` lanes; others repeat the last. */
INLINE Floats load_stored(__global const float *given, const int type, const int i, const int step, const int count) {
    if (LANES > 1 && count >= LANES && step == 1) {
        if (type == FLOAT32) return load_floats(0, given + i);
        if (type == UNORM16) return to_floats(load_uints(0, (__global const ushort *)given + i));
        if (type == UNORM24) return to_floats(load_uints(0, (__global const uint *)given + i) & 0xffffff);
    }
    float lanes[LANES];
    for (int k = 0; k < LANES; ++k) lanes[k] = stored_value(given, type, i + step * min(k, count - 1));
    return load_floats(0, lanes);
}

/* Stored x and y of motion from pixel i on. */
INLINE Floats load_stored_xy(__global const float *given, const int type, const int channels, const int i,
                             const int count, Floats *y) {
    if (IS_WHOLE(count) && channels == 2 && (type == FLOAT32 || type == FLOAT16)) {
        const Pairs xy =
            type == FLOAT32 ? load_pairs(given + 2 * i) : load_half_pairs((__global const half *)given + 2 * i);
        *y = xy.odd;
        return xy.even;
    }
    *y = load_stored(given, type, channels * i + 1, channels, count);
    return load_stored(given, type, channels * i, channels, count);
}

/* Planar depth of the natural logarithm of (z + c) / (near + c), c being 1 for a near plane of 0 and else 0. */
INLINE Floats depth_of_logarithm(const Floats logarithm, const float near) {
    const Floats low = logarithm < -MOST_POWER ? (Floats)(-MOST_POWER) : logarithm;
    return near + (near > 0.0f ? near : 1.0f) * exp_less_one(low > MOST_POWER ? (Floats)(MOST_POWER) : low);
}

/* Planar depth of stored numbers, or distance. Depth of a buffer beyond its range, or at the far end as when cleared,
 * is sky. */
INLINE Floats depth_of_stored(__constant Frame *frame, const Floats stored) {
    const float4 numbers = frame->given_depth;  /* factor, origin, addend, sky */
    if (frame->depth_law == DEPTH_LOGARITHMIC) {
        const Floats z = depth_of_logarithm(numbers.x * (stored - numbers.y), numbers.z);
        return stored == numbers.w ? (Floats)(INFINITY) : z;
    }
    const Floats value = numbers.x * (stored - numbers.y) + numbers.z;
    if (frame->depth_law == DEPTH_LINEAR || frame->depth_law == DEPTH_DISTANCE) return value;
    const Ints is_sky = (stored == numbers.w) | (value <= 1.0f / DEPTH_MOST);
    return is_sky ? (Floats)(INFINITY) : wide_divide((Floats)(1.0f), value);
}

/* Planar depth of what is stored at pixel (px_x, px_y) of the geometry: distances are along the rays. */
INLINE Floats planar_depth(__constant Frame *frame, const Floats stored, const int px_x, const int px_y) {
    const Floats z = depth_of_stored(frame, stored);
    if (frame->depth_law != DEPTH_DISTANCE) return z;
    const float4 from = frame->from_geometry, inverse = frame->to_previous.source_inverse;
    const Floats x = (row_centers(px_x) * from.x + from.z - inverse.z) * inverse.x;
    const float y = ((px_y + 0.5f) * from.y + from.w - inverse.w) * inverse.y;
    return wide_divide(z, wide_root(1.0f + x * x + y * y));
}

/* Motion of static points at depth z, in pixels of color: 0 where depth is invalid or there is no frame before, NaN
   where the point was behind the camera. (px_x, px_y): pixel of the geometry. */
INLINE Floats motion_by_camera(__constant Frame *frame, const int px_x, const int px_y, const Floats z, Floats *y) {
    const float4 from = frame->from_geometry;
    const Floats here_x = row_centers(px_x) * from.x + from.z;
    const float here_y = (px_y + 0.5f) * from.y + from.w;
    const Wide3 before = wide_reproject(here_x, (Floats)(here_y), z, frame->to_previous);
    const Ints known = z > 0.0f, front = before.z > 0.0f;
    *y = known ? (front ? before.y - here_y : (Floats)(NAN)) : (Floats)(0.0f);
    return known ? (front ? before.x - here_x : (Floats)(NAN)) : (Floats)(0.0f);
}

/* Depth and motion of any type and convention that a description allows, at the size of the geometry; motion becomes
   pixels of color. Values of the description's own for unwritten vectors are not counted as bad. */
WIDE __kernel void convert_geometry(__constant Frame *restrict frame, __global const uchar *given_depth,
                                    const int depth_start, __global const uchar *given_motion, const int motion_start,
                                    __global float *depth, __global float2 *motion, __global uchar *bad_pixels) {
    const int width = frame->geometry_width, height = frame->geometry_height, y = get_global_id(1);
    if ((int)get_global_id(0) * LANES >= runs_of(width) || y >= height) return;
    const int row = given_row(frame->rows_up, height, y);
    const int depth_type = frame->given_types.y, motion_type = frame->given_types.z;
    const int camera_motion = frame->given_types.w, channels = frame->given_channels.y;
    __global const float *depths = given_from(given_depth, depth_type, depth_start);
    __global const float *vectors = given_from(given_motion, motion_type, motion_start);
    const float4 numbers = frame->given_motion;  /* factors and addends of x and y */
    const float diagonal_squared = diagonal_squared_of(frame->source_width, frame->source_height);
    int bad_depth = 0, bad_motion = 0, far = 0, too_long = 0;
    for (int k = 0; k < RUN_PIXELS; ++k) {
        const int x = run_x(width, k), count = width - x, i = y * width + x, g = row * width + x;
        if (count <= 0) break;
        const Floats given_z = planar_depth(frame, load_stored(depths, depth_type, g, 1, count), x, y);
        const Floats z = checked_depth(given_z, count, &bad_depth, &far);
        store_some_floats(z, count, depth + i);
        Floats motion_x = (Floats)(0.0f), motion_y = (Floats)(0.0f);
        if (motion_type != NO_BUFFER) {
            Floats stored_y;
            const Floats stored_x = load_stored_xy(vectors, motion_type, channels, g, count, &stored_y);
            const Ints unwritten = (stored_x == frame->motion_invalid) & (stored_y == frame->motion_invalid);
            motion_x = unwritten ? (Floats)(0.0f) : stored_x * numbers.x + numbers.z;
            motion_y = unwritten ? (Floats)(0.0f) : stored_y * numbers.y + numbers.w;
            check_motion(&motion_x, &motion_y, count, diagonal_squared, &bad_motion, &too_long);
            if (camera_motion == CAMERA_INCLUDED) {
                motion_x = unwritten ? (Floats)(NAN) : motion_x;
                motion_y = unwritten ? (Floats)(NAN) : motion_y;
            } else if (frame->has_previous) {
                Floats camera_y;
                const Floats camera_x = motion_by_camera(frame, x, y, z, &camera_y);
                const Ints added = camera_motion == CAMERA_EXCLUDED ? (Ints)(ALL_LANES) : unwritten;
                motion_x = added ? motion_x + camera_x : motion_x;
                motion_y = added ? motion_y + camera_y : motion_y;
            }
        }
        store_some_xy(motion_x, motion_y, count, motion + i);
    }
    store_counts(frame->source_width, frame->source_height, 2, bad_depth, bad_motion, bad_pixels);
    store_counts(frame->source_width, frame->source_height, 4, far, too_long, bad_pixels);
}

/* Motion of the size of the geometry without dilation, from vectors of the nearest of 3x3 samples. Of those around a
   sample that show its surface and nothing nearer beside it, the one counts whose vector comes from closest by: often
   that is the sample itself. If there is none, and something nearer beside the sample, it is taken for static. */
WIDE __kernel void undo_dilation(__constant Frame *restrict frame, __global const float *depth,
                                 __global const float2 *dilated, __global float2 *motion) {
    const int width = frame->geometry_width, height = frame->geometry_height;
    const int x = (int)get_global_id(0) * LANES, y = get_global_id(1), count = width - x;
    if (x >= width || y >= height) return;
    const int reach = SQUARE / 2;
    const bool inner = x >= reach && y >= reach && x + LANES + reach <= width && y + reach < height;
    const Span p = {x, y, width, height, inner};
    Floats around[SQUARE * SQUARE]; /* depths; 0 beyond the image */
#pragma unroll
    for (int k = 0; k < SQUARE * SQUARE; ++k) {
        const int dx = k % SQUARE - reach, dy = k / SQUARE - reach;
        around[k] = is_inside(p, dx, dy) ? beside(p, depth, dx, dy) : (Floats)(0.0f);
    }
    const Floats z = around[MIDDLE];
    const Ints here = y * width + min(x + LANE_NUMBERS, (Ints)(width - 1));
    Ints chosen = here, distance = (Ints)(INT_MAX);
#pragma unroll
    for (int q = 0; q < 9; ++q) {
        const int step_x = q % 3 - 1, step_y = q / 3 - 1, center = MIDDLE + step_y * SQUARE + step_x;
        const Floats own = around[center];
        Floats least = own;
        Ints from = (Ints)(step_x * step_x + step_y * step_y); /* squared distance to the nearest of the 3x3 */
#pragma unroll
        for (int tap = 0; tap < 9; ++tap) {
            const int from_x = step_x + tap % 3 - 1, from_y = step_y + tap / 3 - 1;
            const Floats other = around[MIDDLE + from_y * SQUARE + from_x];
            const Ints nearer = (other > 0.0f) & (other < least);
            least = nearer ? other : least;
            from = nearer ? (Ints)(from_x * from_x + from_y * from_y) : from;
        }
        const Ints same = isinf(z) ? isinf(own) : fabs(own - z) <= SAME_SURFACE * z;
        const Ints better = (z > 0.0f) & (own > 0.0f) & same & (least >= NEARER * own) & (from < distance);
        distance = better ? from : distance;
        chosen = better ? here + (step_y * width + step_x) : chosen;
    }
    Floats motion_y, motion_x = gather_xy(dilated, chosen, &motion_y);
    const Ints lost = (distance == INT_MAX) & (z > 0.0f);
    if (frame->has_previous && ANY(lost)) {
        Floats camera_y;
        const Floats camera_x = motion_by_camera(frame, x, y, z, &camera_y);
        motion_x = lost ? camera_x : motion_x;
        motion_y = lost ? camera_y : motion_y;
    }
    store_some_xy(motion_x, motion_y, count, motion + y * width + x);
}

/* Whether a sample of the geometry shows the surface of another one, with depth z and motion (x, y); never, if a number
   of either is NaN. */
INLINE Ints is_alike(const Floats z, const Floats x, const Floats y, const Floats other_z, const Floats other_x,
                     const Floats other_y) {
    const Ints near = isinf(z) ? isinf(other_z) : fabs(other_z - z) <= SAME_SURFACE * z;
    return near & (fabs(other_x - x) <= ALIKE_MOTION) & (fabs(other_y - y) <= ALIKE_MOTION);
}

/* Color at the position of the geometry's sample (x, y), interpolated. */
INLINE float3 color_of_sample(__constant Frame *frame, __global const half *color, const int x, const int y) {
    const int width = frame->source_width, height = frame->source_height;
    const float4 from = frame->from_geometry;
    const float px_x = clamp((x + 0.5f) * from.x + from.z - 0.5f, 0.0f, (float)(width - 1));
    const float px_y = clamp((y + 0.5f) * from.y + from.w - 0.5f, 0.0f, (float)(height - 1));
    const int x0 = (int)px_x, y0 = (int)px_y, right = x0 < width - 1, down = y0 < height - 1;
    const float u = px_x - (float)x0, v = px_y - (float)y0;
    float3 sum = (float3)(0.0f);
    for (int tap = 0; tap < 4; ++tap) {
        const int i = (y0 + (tap >> 1) * down) * width + x0 + (tap & 1) * right;
        sum += load_color(color, i) * bilinear_weight(tap, u, v);
    }
    return sum;
}

/* Depth, and motion x and y, of pixel i of color beside an edge of the geometry. Its surface is that of the sample
   among the four around it whose color is like the pixel's and which is near; the others add to it only if they show
   that surface. `taps`: their indices; (u, v): the pixel's position from the first. */
INLINE float3 geometry_at_edge(__constant Frame *frame, __global const half *color, __global const float *depths,
                               __global const float2 *vectors, const int i, const int4 taps, const float u,
                               const float v) {
    const int indices[4] = {taps.x, taps.y, taps.z, taps.w};
    const float3 own = load_color(color, i);
    const float light = own.x + own.y + own.z, far = NEARNESS * (light * light + 1e-6f);
    float least = INFINITY;
    int chosen = 0;
    for (int tap = 0; tap < 4; ++tap) {
        const int row = indices[tap] / frame->geometry_width, column = indices[tap] - row * frame->geometry_width;
        const float3 off = color_of_sample(frame, color, column, row) - own;
        const float x = u - (float)(tap & 1), y = v - (float)(tap >> 1);
        const float cost = off.x * off.x + off.y * off.y + off.z * off.z + far * (x * x + y * y);
        chosen = cost < least ? indices[tap] : chosen;
        least = cost < least ? cost : least;
    }
    const float z = depths[chosen];
    const float2 motion = vectors[chosen];
    float sum = 0.0f, sum_z = 0.0f;
    float2 sum_motion = (float2)(0.0f);
    for (int tap = 0; tap < 4; ++tap) {
        const float other_z = depths[indices[tap]];
        const bool near = is_same_surface(other_z, z, SAME_SURFACE * z);
        const float2 other = vectors[indices[tap]];
        if (!near || !(fabs(other.x - motion.x) <= ALIKE_MOTION) || !(fabs(other.y - motion.y) <= ALIKE_MOTION))
            continue;
        const float weight = bilinear_weight(tap, u, v);
        sum += weight;
        sum_z += weight * other_z;
        sum_motion += weight * other;
    }
    if (!(sum > 0.0f)) return (float3)(z, motion.x, motion.y);
    return (float3)(isinf(z) ? z : divide(sum_z, sum), divide(sum_motion.x, sum), divide(sum_motion.y, sum));
}

/* Depth and motion of the size of color from smaller, perhaps jittered ones. Within a surface they are interpolated;
   edges of depth and motion follow those of color. */
WIDE __kernel void spread_geometry(__constant Frame *restrict frame, __global const half *color,
                                   __global const float *small_depth, __global const float2 *small_motion,
                                   __global float *depth, __global float2 *motion) {
    const int width = frame->source_width, x = (int)get_global_id(0) * LANES, y = get_global_id(1), count = width - x;
    if (x >= width || y >= frame->source_height) return;
    const float4 to = frame->to_geometry;
    const int columns = frame->geometry_width, last_x = columns - 1, last_y = frame->geometry_height - 1;
    const Floats at_x = clamp(row_centers(x) * to.x + to.z - 0.5f, (Floats)(0.0f), (Floats)((float)last_x));
    const Floats at_y = (Floats)(clamp((y + 0.5f) * to.y + to.w - 0.5f, 0.0f, (float)last_y));
    const Ints left = to_ints(at_x), top = to_ints(at_y);
    const Ints right = min(left + 1, (Ints)(last_x)), bottom = min(top + 1, (Ints)(last_y));
    const Floats u = at_x - to_floats(left), v = at_y - to_floats(top);
    const Ints taps[4] = {top * columns + left, top * columns + right, bottom * columns + left,
                          bottom * columns + right};
    const Ints in_right = u >= 0.5f, in_lower = v >= 0.5f;
    const Ints nearest = in_lower ? (in_right ? taps[3] : taps[2]) : (in_right ? taps[1] : taps[0]);
    const Floats z = gather_floats(small_depth, nearest);
    Floats own_y, other_y;
    const Floats own_x = gather_xy(small_motion, nearest, &own_y);
    Ints smooth = (Ints)(ALL_LANES);
    Floats sum_z = (Floats)(0.0f), sum_x = (Floats)(0.0f), sum_y = (Floats)(0.0f);
    for (int tap = 0; tap < 4; ++tap) {
        const Floats weight = ((tap & 1) ? u : 1.0f - u) * ((tap >> 1) ? v : 1.0f - v);
        const Floats other_z = gather_floats(small_depth, taps[tap]);
        const Floats other_x = gather_xy(small_motion, taps[tap], &other_y);
        smooth &= is_alike(z, own_x, own_y, other_z, other_x, other_y);
        sum_z += weight * other_z;
        sum_x += weight * other_x;
        sum_y += weight * other_y;
    }
    sum_z = isinf(z) ? z : sum_z;
    if (!ALL(smooth)) {
        for (int k = 0; k < min(count, LANES); ++k) {
            if (int_of(&smooth, k)) continue;
            const int4 around =
                (int4)(int_of(&taps[0], k), int_of(&taps[1], k), int_of(&taps[2], k), int_of(&taps[3], k));
            const float3 found = geometry_at_edge(frame, color, small_depth, small_motion, y * width + x + k, around,
                                                  float_of(&u, k), float_of(&v, k));
            set_float(&sum_z, k, found.x);
            set_float(&sum_x, k, found.y);
            set_float(&sum_y, k, found.z);
        }
    }
    store_some_floats(sum_z, count, depth + y * width + x);
    store_some_xy(sum_x, sum_y, count, motion + y * width + x);
}
