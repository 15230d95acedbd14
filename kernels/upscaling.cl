/* Temporal anti-aliasing and upsampling: jittered frames of render size, gathered over time at the display's size.

   A mapping is (scale x, scale y, offset x, offset y) between pixel positions of two images of one pose; jitter is in
   them. Colors are linear in `color` and `history`; blending and bounds are in YCoCg of tone-mapped color
   ("compressed").

   Of the rendered frame, at render size: `compressed` color, the share of its place that was not hidden before as its
   fourth channel; `dilated` motion, of the nearest surface around, NaN where nothing is known; the `surprise`, which is
   how far the color is beyond the history around, and 1 where there is any; of 3x3 compressed colors the `mean`, and
   the history's error in deviations, and the `deviation`, and how much more light there is than in the history.

   At the display's size: the `history`, linear color that is displayed, and the number of its samples; the `lock`,
   frames in which it foretold the samples at rest, more for a thin feature; the `rejected` share of the history. */

#include "frame.h"
#include "stencil.h"
#include "simd_texels.h"

/* What set the thresholds: docs/upscaling.md, "Figures". */
#define FILTER_REACH 1.2f /* display pixels: from where on a sample does not count */
#define MOST_WEIGHT 12.0f     /* of a history at rest, in samples */
#define MOVED_WEIGHT 1.0f     /* of one that moved: it blurs whenever it is resampled */
#define LEAST_SHOWN 0.5f /* weight of the displayed color until samples arrive; below it, these count less, too */
#define FRESH 0.8f /* share of the rendered frame, interpolated, in that; the rest is the history, clipped */
#define SHARP_SLOPE 0.75f /* of the cubic that resamples the history: Catmull-Rom's 0.5 blurs in the long run */
#define DEVIATIONS 2.0f /* deviations from the mean that a history may have */
#define COMPRESSED_NOISE 0.01f /* of compressed colors, in addition to their deviation */
#define SCATTER 1.0f /* weight of the scatter of the history's error, against its mean, which is followed */
#define WRONG 1.0f /* deviations: error from which on a history that moved is not believed */
#define WRONG_AT_REST 3.0f
#define UNREST 10.0f /* per squared pixel of motion */
#define AT_REST 0.1f /* pixels of motion up to which thin features are kept */
#define AGREED 0.5f /* trust from which on a frame counts for a lock */
#define LOCK_FRAMES 8 /* that count at most */
#define SETTLED 4.0f /* from which on something nearer that is gone was thin, and no sample meets it now */
#define THIN 16 /* the lock of such a feature; one less in each frame, down to LOCK_FRAMES */
#define MET 0.75f /* share of a place that was not hidden from which on nothing is gone */
#define LOCKED_ROOM 0.5f /* tolerance of compressed color, in addition to DEVIATIONS */
#define MOST_ERROR 1000.0f /* deviations; half has room for it */
#define NOT_NEARER 0.96f /* relative depth from which on it is the same surface */

/* Tone-mapped by the largest channel, so that bright samples do not outweigh all others; as (Y, Co, Cg). */
INLINE Wide4 compressed_of(const Wide4 rgb, const float exposure) {
    Floats lit[3];
#pragma unroll
    for (int k = 0; k < 3; ++k) lit[k] = wide_greater(rgb.c[k], (Floats)(0.0f)) * exposure;
    const Floats scale = wide_divide((Floats)(1.0f), 1.0f + wide_greater(lit[0], wide_greater(lit[1], lit[2])));
    const Floats green = 0.5f * lit[1], others = 0.25f * (lit[0] + lit[2]);
    const Wide4 c = {{(others + green) * scale, (0.5f * (lit[0] - lit[2])) * scale, (green - others) * scale, 0.0f}};
    return c;
}

INLINE Wide4 expanded(const Wide4 ycocg, const float exposure) {
    const Floats y = ycocg.c[0], co = ycocg.c[1], cg = ycocg.c[2], rest = y - cg;
    Wide4 rgb = {{rest + co, y + cg, rest - co, ycocg.c[3]}};
#pragma unroll
    for (int k = 0; k < 3; ++k) rgb.c[k] = wide_greater(rgb.c[k], (Floats)(0.0f));
    const Floats most = 1.0f - wide_greater(rgb.c[0], wide_greater(rgb.c[1], rgb.c[2]));
    const Floats scale = wide_divide((Floats)(1.0f), wide_greater(most, (Floats)(1e-4f)) * exposure);
#pragma unroll
    for (int k = 0; k < 3; ++k) rgb.c[k] = wide_lesser(rgb.c[k] * scale, (Floats)(COLOR_MAX));
    return rgb;
}

INLINE Ints within(const Floats px_x, const Floats px_y, const int width, const int height) {
    return (px_x >= 0.0f) & (px_y >= 0.0f) & (px_x < (float)width) & (px_y < (float)height); /* not of NaN */
}

/* The nearest of the 3x3 pixels around each of LANES, if it is of another surface than the pixel's own, else that:
   their centers and motion. `elsewhere`: whether any is another pixel. */
typedef struct {
    Ints at;
    Floats center_x, center_y, moved_x, moved_y;
    bool elsewhere;
} Nearest;

INLINE Nearest nearest_around(const Span p, __global const float *depth, __global const float2 *motion) {
    const Floats own = beside(p, depth, 0, 0);
    Floats least_depth = own > 0.0f ? NOT_NEARER * own : (Floats)(INFINITY);
    Ints dx = (Ints)(0), dy = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const Floats z = beside(p, depth, k % 3 - 1, k / 3 - 1);
        const Ints nearer = (z > 0.0f) & (z < least_depth);
        least_depth = nearer ? z : least_depth;
        dx = nearer ? (Ints)(k % 3 - 1) : dx;
        dy = nearer ? (Ints)(k / 3 - 1) : dy;
    }
    const Ints x = clamp(p.x + LANE_NUMBERS + dx, (Ints)(0), (Ints)(p.width - 1));
    const Ints y = clamp(p.y + dy, (Ints)(0), (Ints)(p.height - 1));
    Nearest n;
    n.at = y * p.width + x;
    n.center_x = to_floats(x) + 0.5f;
    n.center_y = to_floats(y) + 0.5f;
    n.elsewhere = ANY((dx != 0) | (dy != 0));
    n.moved_x = n.elsewhere ? gather_xy(motion, n.at, &n.moved_y) : xy_beside(p, motion, 0, 0, &n.moved_y);
    return n;
}

/* The share of px in the image before was not hidden by something nearer than `expected`: bilinear. */
INLINE Floats share_seen(const Floats px_x, const Floats px_y, const Floats expected, const int width, const int height,
                         __global const float *previous_depth) {
    const Ints met = within(px_x, px_y, width, height);
    const Floats corner_x = met ? px_x - 0.5f : (Floats)(0.0f), corner_y = met ? px_y - 0.5f : (Floats)(0.0f);
    const Floats first_x = floor(corner_x), first_y = floor(corner_y), u = corner_x - first_x, v = corner_y - first_y;
    const Floats nearest = isinf(expected) ? (Floats)(MAXFLOAT) : NOT_NEARER * expected;
    Floats seen = 0.0f;
#pragma unroll
    for (int tap = 0; tap < 4; ++tap) {
        const Ints x = clamp(to_ints(first_x) + (tap & 1), (Ints)(0), (Ints)(width - 1));
        const Ints y = clamp(to_ints(first_y) + (tap >> 1), (Ints)(0), (Ints)(height - 1));
        const Floats weight = ((tap & 1) ? u : 1.0f - u) * ((tap >> 1) ? v : 1.0f - v);
        seen += gather_floats(previous_depth, y * width + x) < nearest ? (Floats)(0.0f) : weight;
    }
    return met ? seen : (Floats)(0.0f);
}

/* c within the least and the most of the 2x2 texels of an image around px. */
INLINE Wide4 within_range(Wide4 color, const Floats px_x, const Floats px_y, const int width, const int height,
                          __global const half *image) {
    const Ints left = to_ints(floor(px_x - 0.5f)), top = to_ints(floor(px_y - 0.5f));
    float low[4 * LANES], high[4 * LANES];
    for (int k = 0; k < LANES; ++k) {
        const int x = int_of(&left, k), y = int_of(&top, k);
        const float8 a = two_texels(image, x, y, width, height), b = two_texels(image, x, y + 1, width, height);
        const float8 least = a < b ? a : b, most = a < b ? b : a;
        vstore4(least.lo < least.hi ? least.lo : least.hi, k, low);
        vstore4(most.lo < most.hi ? most.hi : most.lo, k, high);
    }
    const Wide4 least = channels_in(low), most = channels_in(high);
#pragma unroll
    for (int k = 0; k < 3; ++k) color.c[k] = within_limits(color.c[k], least.c[k], most.c[k]);
    return color;
}

/* Writes, for each rendered pixel, where its surroundings were, and the distance of its color from the history there.
 */
WIDE __kernel void compare(__constant Frame *restrict frame, __global const half *color, __global const float *depth,
                           __global const float2 *motion, __global const float *previous_depth,
                           __global const half *history, __global half *out_compressed, __global float2 *out_dilated,
                           __global half *out_surprise) {
    const int source_width = frame->source_width, source_height = frame->source_height;
    const int has_history = frame->has_previous;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), i = y * source_width + x, count = source_width - x;
    if (x >= source_width || y >= source_height) return;
    const Span p = span_at(x, y, source_width, source_height);

    /* Where the nearest surface around was, and how much of that was seen. */
    const Nearest near = nearest_around(p, depth, motion);
    const Floats z = near.elsewhere ? gather_floats(depth, near.at) : beside(p, depth, 0, 0);
    const Ints moves = (z > 0.0f) & ((Ints)(has_history) != 0);
    Floats seen = 0.0f;
    if (has_history) {
        const Wide3 v = wide_unproject(near.center_x, near.center_y, z, frame->to_previous.source_inverse);
        const float4 forward = frame->to_previous.row2;
        const Floats expected = forward.x * v.x + forward.y * v.y + forward.z * v.z + forward.w;
        const Floats share =
            share_seen(near.center_x + near.moved_x, near.center_y + near.moved_y,
                       isinf(z) ? (Floats)(INFINITY) : expected, source_width, source_height, previous_depth);
        seen = z > 0.0f ? share : (Floats)(0.0f);
    }
    /* How the color differs from the history there. */
    const Wide4 own = finite_rgb(gather_channels(color, clamped_beside(p, 0, 0)));
    Wide4 here = compressed_of(own, frame->exposure), surprise = {{0.0f, 0.0f, 0.0f, 0.0f}};
    const Ints known = seen > 0.0f;
    if (ANY(known)) {
        const float4 to = frame->to_previous_display;
        const Floats px_x = (row_centers(x) + near.moved_x) * to.x + to.z;
        const Floats px_y = ((float)y + 0.5f + near.moved_y) * to.y + to.w;
        const Wide4 foretold =
            compressed_of(within_range(own, known ? px_x : (Floats)(0.0f), known ? px_y : (Floats)(0.0f),
                                       frame->target_width, frame->target_height, history),
                          frame->exposure);
#pragma unroll
        for (int k = 0; k < 3; ++k) surprise.c[k] = known ? here.c[k] - foretold.c[k] : (Floats)(0.0f);
        surprise.c[3] = known ? (Floats)(1.0f) : (Floats)(0.0f);
    }
    here.c[3] = seen;
    store_channels(here, count, out_compressed + 4 * i);
    store_some_xy(moves ? near.moved_x : (Floats)(NAN), moves ? near.moved_y : (Floats)(NAN), count, out_dilated + i);
    store_channels(surprise, count, out_surprise + 4 * i);
}

/* Sums over 3x3 pixels, of the channels and of their squares. */
INLINE void sums_beside(const Span p, __global const half *image, Wide4 *sum, Wide4 *square) {
    Strip sums, squares;
#pragma unroll
    for (int part = 0; part < PARTS; ++part) sums.part[part] = squares.part[part] = (Texels)(0.0f);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        Strip c;
        texels_beside(p, image, k % 3 - 1, k / 3 - 1, &c);
#pragma unroll
        for (int part = 0; part < PARTS; ++part) {
            sums.part[part] += c.part[part];
            squares.part[part] += c.part[part] * c.part[part];
        }
    }
    *sum = channels_of(&sums);
    *square = channels_of(&squares);
}

/* Colors around each rendered pixel, and how well the history foretold them: it may be darker or lighter than they are,
   which is compensated; the rest is its error. */
WIDE __kernel void survey(__constant Frame *restrict frame, __global const half *compressed,
                          __global const half *surprise, __global half *out_mean, __global half *out_deviation) {
    const int source_width = frame->source_width, source_height = frame->source_height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), i = y * source_width + x, count = source_width - x;
    if (x >= source_width || y >= source_height) return;
    const Span p = span_at(x, y, source_width, source_height);
    const float ninth = 1.0f / 9.0f;
    Wide4 middle, square, off, off_square;
    Floats variance[3];
    sums_beside(p, compressed, &middle, &square);
    sums_beside(p, surprise, &off, &off_square);
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        middle.c[c] *= ninth;
        variance[c] = wide_greater(square.c[c] * ninth - middle.c[c] * middle.c[c], (Floats)(0.0f));
    }
    const Floats per_known = wide_divide((Floats)(1.0f), wide_greater(off.c[3], (Floats)(1.0f)));
    const Floats bias = off.c[0] * per_known,
                 scatter = wide_greater(off_square.c[0] * per_known - bias * bias, (Floats)(0.0f));
    const Floats shift = bias * wide_divide(bias * bias, bias * bias + SCATTER * scatter + 1e-8f);
    const Floats missed =
        wide_greater((off_square.c[0] + off_square.c[1] + off_square.c[2]) * per_known - shift * (2.0f * bias - shift),
                     (Floats)(0.0f));
    const Floats error =
        wide_root(wide_divide(missed, variance[0] + variance[1] + variance[2] + COMPRESSED_NOISE * COMPRESSED_NOISE));
    const Wide4 of_mean = {{middle.c[0], middle.c[1], middle.c[2], wide_lesser(error, (Floats)(MOST_ERROR))}};
    const Wide4 deviation = {{wide_root(variance[0]), wide_root(variance[1]), wide_root(variance[2]), shift}};
    store_channels(of_mean, count, out_mean + 4 * i);
    store_channels(deviation, count, out_deviation + 4 * i);
}

/* The history that was found, in today's light, within a few deviations of the mean and `more_room`; its fourth
   channel. */
INLINE Wide4 bounded(const Wide4 found, const Wide4 mean, const Wide4 around, const Floats more_room,
                     const float exposure) {
    Wide4 past = compressed_of(found, exposure);
    const Floats gain = wide_divide(wide_greater(past.c[0] + around.c[3], (Floats)(0.0f)), past.c[0] + 1e-4f);
#pragma unroll
    for (int k = 0; k < 3; ++k) {
        const Floats room = DEVIATIONS * around.c[k] + (COMPRESSED_NOISE + more_room);
        past.c[k] = within_limits(past.c[k] * gain, mean.c[k] - room, mean.c[k] + room);
    }
    past.c[3] = found.c[3];
    return past;
}

/* The lock of a pixel at rest: number of frames in which the history was right. If it is large, and a nearer surface
   disappears by depth, that surface was thin, and will be hit again. */
INLINE Floats lock_of(const Floats before, const Ints right, const Floats seen) {
    const Floats most = (float)LOCK_FRAMES, counted = before + (right ? (Floats)(1.0f) : (Floats)(-1.0f));
    const Floats next = before > most ? before - 1.0f : within_limits(counted, (Floats)(0.0f), most);
    const Ints thin = (seen < MET) & (before >= SETTLED);
    return thin ? (Floats)(THIN) : next;
}

/* Weights of three samples in a row, a rendered pixel apart, the middle one `off` display pixels away. */
INLINE void near_weights(const Floats off, const float size, Floats *weights) {
    for (int k = 0; k < 3; ++k) {
        const Floats t = (off + (float)(k - 1) * size) * (1.0f / FILTER_REACH),
                     left = wide_greater(1.0f - t * t, (Floats)(0.0f));
        weights[k] = left * left * left;
    }
}

/* Weights of three samples for interpolation between them; `off` in rendered pixels. */
INLINE void far_weights(const Floats off, Floats *weights) {
    const Floats within = within_limits(off, (Floats)(-1.0f), (Floats)(1.0f));
    for (int k = 0; k < 3; ++k) {
        const Floats t = within + (float)(k - 1), left = wide_greater(1.0f - t * t, (Floats)(0.0f));
        weights[k] = left * left;
    }
}

/* Weights of 3x3 samples: those of the columns, for each of LANES pixels of a row, and of the rows. */
typedef struct {
    Floats x[3];
    float3 y;
} Weights;

INLINE Weights weights_of(const Floats *x, const Floats *y) {
    const Weights w = {{x[0], x[1], x[2]}, (float3)(FIRST_LANE(y[0]), FIRST_LANE(y[1]), FIRST_LANE(y[2]))};
    return w;
}

INLINE float16 columns_of(const float3 wy, const float16 above, const float16 here, const float16 below) {
    return wy.x * above + wy.y * here + wy.z * below;
}

/* Weighted sums of a row of samples for the pixels of a part, whose columns start at these floats of `columns`. */
INLINE Texels rows_of(const Weights *w, const int part, const int *first, const float *columns) {
    Texels sum;
#pragma unroll
    for (int tap = 0; tap < 3; ++tap) {
        float texels[4 * TEXELS];
#pragma unroll
        for (int k = 0; k < TEXELS; ++k) vstore4(vload4(tap, columns + first[k]), k, texels);
        const Texels weighted = OF_TEXELS(w->x[tap], part) * reload_texels(0, texels);
        sum = tap == 0 ? weighted : sum + weighted;
    }
    return sum;
}

/* Weighted sums of the 3x3 samples around a pixel, a column at a time: all of them at once take 36 registers. */
INLINE void sums_of_one(const int x, const int y, float3 near_x, const float3 near_y, float3 far_x, const float3 far_y,
                        const int width, const int height, __global const half *compressed, float4 *near_sum,
                        float4 *far_sum) {
    const int above_row = clamp(y - 1, 0, height - 1) * width, below_row = clamp(y + 1, 0, height - 1) * width;
#pragma unroll 1
    for (int k = 0; k < 3; ++k) { /* near_x.x and far_x.x are the weights of this column */
        const int column = clamp(x + k - 1, 0, width - 1);
        const float4 above = load_texel(above_row + column, compressed),
                     here = load_texel(y * width + column, compressed),
                     below = load_texel(below_row + column, compressed);
        const float4 a = near_x.x * (near_y.x * above + near_y.y * here + near_y.z * below);
        const float4 b = far_x.x * (far_y.x * above + far_y.y * here + far_y.z * below);
        *near_sum = k == 0 ? a : *near_sum + a;
        *far_sum = k == 0 ? b : *far_sum + b;
        near_x = near_x.yzz;
        far_x = far_x.yzz;
    }
}

/* The weighted sum of the 3x3 samples around each of LANES pixels of a row, and one with other weights. */
INLINE Wide4 sums_around(const Ints x, const int y, const Weights near, const Weights far, const int width,
                         const int height, __global const half *compressed, Wide4 *far_sum) {
    const int first = FIRST_LANE(x);
    if (LANES > 1 && LAST_LANE(x) - first <= 9) { /* pixels are small, or of one size: they share columns */
        float near_columns[48], far_columns[48];
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            const float16 above = four_texels(compressed, first - 1 + 4 * k, y - 1, width, height),
                          here = four_texels(compressed, first - 1 + 4 * k, y, width, height),
                          below = four_texels(compressed, first - 1 + 4 * k, y + 1, width, height);
            vstore16(columns_of(near.y, above, here, below), k, near_columns);
            vstore16(columns_of(far.y, above, here, below), k, far_columns);
        }
        Strip s, t;
#pragma unroll
        for (int part = 0; part < PARTS; ++part) {
            int from[TEXELS];
            for (int k = 0; k < TEXELS; ++k) from[k] = 4 * (int_of(&x, part * TEXELS + k) - first);
            s.part[part] = rows_of(&near, part, from, near_columns);
            t.part[part] = rows_of(&far, part, from, far_columns);
        }
        *far_sum = channels_of(&t);
        return channels_of(&s);
    }
    float sums[4 * LANES], far_sums[4 * LANES];
    for (int k = 0; k < LANES; ++k) {
        const float3 near_x = (float3)(float_of(&near.x[0], k), float_of(&near.x[1], k), float_of(&near.x[2], k)),
                     far_x = (float3)(float_of(&far.x[0], k), float_of(&far.x[1], k), float_of(&far.x[2], k));
        float4 near_all, far_all;
        sums_of_one(int_of(&x, k), y, near_x, near.y, far_x, far.y, width, height, compressed, &near_all, &far_all);
        vstore4(near_all, k, sums);
        vstore4(far_all, k, far_sums);
    }
    *far_sum = channels_in(far_sums);
    return channels_in(sums);
}

INLINE Floats sum_of_weights(const Weights w) { return (w.x[0] + w.x[1] + w.x[2]) * (w.y.x + w.y.y + w.y.z); }

/* The rendered frame, surveyed, and the history so far. */
typedef struct {
    __global const half *mean, *deviation, *history;
    __global const uchar *lock;
} Past;

/* History of LANES pixels: their colors, their worth in samples, their confidence, 0 to 1, and their locks. */
typedef struct {
    Wide4 color;
    Floats held, believed, locked;
} Recalled;

/* The history at px_previous, for those that are `known` there: believed as far as it foretold the samples around
   `src`, within their colors; less where it moved, from there to `px`. `seen`: by depth. */
INLINE void recall(__constant Frame *frame, const Past past, const Floats *px, const Ints known,
                   const Floats *px_previous, const Ints src, const Floats seen, Recalled *r) {
    const int width = frame->target_width, height = frame->target_height;
    const Floats at_x = known ? px_previous[0] : (Floats)(0.0f), at_y = known ? px_previous[1] : (Floats)(0.0f);
    const Floats motion = fabs(at_x - px[0]) + fabs(at_y - px[1]);
    const Floats rest = wide_divide((Floats)(1.0f), 1.0f + UNREST * motion * motion);
    const Wide4 middle = gather_channels(past.mean, src), around = gather_channels(past.deviation, src);
    const Floats trust =
        wide_greater(1.0f - wide_divide(middle.c[3], WRONG + (WRONG_AT_REST - WRONG) * rest), (Floats)(0.0f));
    const Floats before = to_floats(gather_bytes(past.lock, to_ints(at_y) * width + to_ints(at_x)));
    const Ints rests = known & (motion < AT_REST);
    r->locked = rests ? lock_of(before, trust * seen >= AGREED, seen) : (Floats)(0.0f);
    const Ints thin = r->locked > (float)LOCK_FRAMES;
    r->color = bounded(cubic_at(known, px_previous[0], px_previous[1], width, height, SHARP_SLOPE, past.history),
                       middle, around, thin ? (Floats)(LOCKED_ROOM) : (Floats)(0.0f), frame->exposure);
    r->believed = known ? trust * (thin ? (Floats)(1.0f) : seen) : (Floats)(0.0f);
    r->held = wide_lesser(r->color.c[3] * r->believed, MOVED_WEIGHT + (MOST_WEIGHT - MOVED_WEIGHT) * rest);
}

/* The rendered frame into the history. */
WIDE __kernel void accumulate(__constant Frame *restrict frame, __global const half *compressed,
                              __global const float2 *dilated, __global const half *mean, __global const half *deviation,
                              __global const half *history, __global const uchar *lock, __global half *out_history,
                              __global uchar *out_lock, __global uchar *rejected) {
    const Past past = {mean, deviation, history, lock};
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int source_width = frame->source_width, source_height = frame->source_height;
    const float4 to_render = frame->to_render, to_previous_display = frame->to_previous_display;
    const int dst_x = get_global_id(0) * LANES, dst_y = get_global_id(1);
    const int dst = dst_y * target_width + dst_x, count = target_width - dst_x;
    if (dst_x >= target_width || dst_y >= target_height) return;
    const Floats px_x = row_centers(dst_x) * to_render.x + to_render.z;
    const float px_y = ((float)dst_y + 0.5f) * to_render.y + to_render.w;
    const Ints x = clamp(to_ints(floor(px_x)), (Ints)(0), (Ints)(source_width - 1));
    const int y = clamp((int)floor(px_y), 0, source_height - 1);
    const Ints src = y * source_width + x;

    /* Samples near these pixels, and the frame itself, interpolated. */
    const Floats off_x = to_floats(x) + 0.5f - px_x, off_y = (float)y + 0.5f - px_y;
    Floats wx[3], wy[3], far_x[3], far_y[3];
    near_weights(off_x * frame->pixel_size.x, frame->pixel_size.x, wx);
    near_weights(off_y * frame->pixel_size.y, frame->pixel_size.y, wy);
    far_weights(off_x, far_x);
    far_weights(off_y, far_y);
    const Weights near = weights_of(wx, wy), far = weights_of(far_x, far_y);
    Wide4 fresh;
    Wide4 sum = sums_around(x, y, near, far, source_width, source_height, compressed, &fresh);
    Floats total = sum_of_weights(near);
    const Floats per_far = wide_divide((Floats)(1.0f), sum_of_weights(far));

    const Floats px[2] = {row_centers(dst_x), (Floats)((float)dst_y + 0.5f)};
    Floats moved_y, px_previous[2];
    const Floats moved_x = gather_xy(dilated, src, &moved_y), none = 0.0f;
    px_previous[0] = (px_x + moved_x) * to_previous_display.x + to_previous_display.z;
    px_previous[1] = (px_y + moved_y) * to_previous_display.y + to_previous_display.w;
    const Ints known =
        within(px_previous[0], px_previous[1], target_width, target_height) & ((Ints)(frame->has_previous) != 0);
    Recalled r = {{{none, none, none, none}}, none, none, none};
    if (ANY(known)) recall(frame, past, px, known, px_previous, src, fresh.c[3] * per_far, &r);

    /* Without confidence the interpolated frame replaces it; single samples would be dots in a grid. */
    const Floats kept = wide_lesser(r.held * (1.0f / LEAST_SHOWN), (Floats)(1.0f));
    const Floats counted = known ? kept : (Floats)(1.0f), share = FRESH * (1.0f - kept);
    const Floats held = wide_greater(r.held, (Floats)(LEAST_SHOWN));
    total = counted * total + held;
    const Floats scale = wide_divide((Floats)(1.0f), total);
#pragma unroll
    for (int k = 0; k < 3; ++k) {
        const Floats now = fresh.c[k] * per_far, before = r.color.c[k];
        sum.c[k] = (counted * sum.c[k] + held * (known ? before + (now - before) * share : now)) * scale;
    }
    sum.c[3] = wide_lesser(total, (Floats)(MOST_WEIGHT));
    store_channels(expanded(sum, frame->exposure), count, out_history + 4 * dst);
    store_some_bytes(to_bytes(to_ints(r.locked)), count, out_lock + dst);
    store_some_bytes(to_bytes(to_ints(255.0f * (1.0f - r.believed) + 0.5f)), count, rejected + dst);
}

/* A generated frame: the history where its own fragments are seen, with the change by shading correction; else its own
   color. */
WIDE __kernel void generate(__constant Frame *restrict frame, const int corrected, __global const float *depth,
                            __global const float2 *motion, __global const uchar *disoccluded, __global const half *gae,
                            __global const half *color, __global const half *history, __global half *out_color) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const float4 to_shown = frame->to_display;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), i = y * target_width + x, count = target_width - x;
    if (x >= target_width || y >= target_height) return;
    const Span p = span_at(x, y, target_width, target_height);
    const Nearest near = nearest_around(p, depth, motion);
    const Floats px_x = row_centers(x) + ((near.center_x + near.moved_x) * to_shown.x + to_shown.z - near.center_x);
    const Floats px_y = ((float)y + 0.5f) + ((near.center_y + near.moved_y) * to_shown.y + to_shown.w - near.center_y);
    Ints uncovered = bytes_beside(p, disoccluded, 0, 0);
    if (near.elsewhere) uncovered |= to_ints(gather_bytes(disoccluded, near.at));
    const Ints seen = (uncovered == 0) & within(px_x, px_y, target_width, target_height);
    Wide4 shown = cubic_at(seen, px_x, px_y, target_width, target_height, SHARP_SLOPE, history);
    const Ints own_i = clamped_beside(p, 0, 0);
    Wide4 own = shown;
    if (corrected || !ALL(seen)) own = finite_rgb(gather_channels(color, own_i));
    if (corrected) {
        const Wide4 before = finite_rgb(gather_channels(gae, own_i));
#pragma unroll
        for (int k = 0; k < 3; ++k) shown.c[k] += own.c[k] - before.c[k];
    }
#pragma unroll
    for (int k = 0; k < 3; ++k)
        shown.c[k] = seen ? within_limits(shown.c[k], (Floats)(0.0f), (Floats)(COLOR_MAX)) : own.c[k];
    shown.c[3] = 0.0f;
    store_channels(shown, count, out_color + 4 * i);
}
