/* Temporal anti-aliasing and upsampling: jittered frames of render size, gathered over time at the display's size.

   A mapping is (scale x, scale y, offset x, offset y) between pixel positions of two images of one pose; jitter is in them.
   Colours are linear in `color` and `history`; blending and bounds are in YCoCg of tone-mapped colour ("compressed").

              name             image     what
   in         color            render    the rendered frame
              depth, motion    render    its depth, and its motion into the render image before
              previous_depth   render    of the rendered frame before
   between    compressed       render    its colour, compressed; A: share of `dilated` that was not hidden before
              dilated          render    motion of the nearest surface around; NaN where that was hidden before
              surprise         render    how far the colour is beyond the history around, compressed; A: 1 where there is any
              mean             render    of 3x3 compressed colours; A: how far the history is trusted
              deviation        render    theirs; A: by how much more light there is than in the history
   state      history          display   colour, linear: what is shown; A: how many samples are behind it
              lock             display   frames in a row in which it foretold the samples
   out        rejected         display   which share of the history was not believed
              out_color        display   a generated frame, seen through the history                                       */

#include "common.h"
#include "around.h"
#include "strips.h"

#define REACH 1.1f            /* display pixels: from where on a sample does not count */
#define MOST_WEIGHT 12.0f     /* of the history, in samples */
#define LEAST_WEIGHT 0.8f     /* of what is shown until samples come */
#define FRESH 0.55f           /* share of the rendered frame in that; the rest is the history, clipped */
#define DEVIATIONS 1.3f       /* deviations from the mean that a history may have */
#define LOCKED_ROOM 0.5f      /* compressed colour beside that, after LOCK_FRAMES: thin features that no sample meets now */
#define LOCK_FRAMES 8.0f
#define CLOSE 0.4f            /* weight from which on samples tell of the very pixel: they end a lock that they contradict */
#define NOISE 0.015f          /* of compressed colours, beside their deviation */
#define SCATTER 0.5f          /* weight of the scatter of what the history lacks, against its mean, which is followed */
#define RIGHT 0.1f            /* deviations: error up to which the history is believed, and from which on it is not */
#define WRONG 0.9f
#define CLIPPED 4.0f          /* loss of belief by how much had to be clipped */
#define SAME_DEPTH 0.96f      /* relative depth from which on it is the same surface */

/* Tone-mapped by the largest channel, so that bright samples do not outweigh all others; as (Y, Co, Cg). */
INLINE Wide4 compressed_of(const Floats r, const Floats g, const Floats b, const float exposure) {
    const Floats c_r = greater(r, (Floats)(0.0f)) * exposure, c_g = greater(g, (Floats)(0.0f)) * exposure,
                 c_b = greater(b, (Floats)(0.0f)) * exposure;
    const Floats scale = wide_divide((Floats)(1.0f), 1.0f + greater(c_r, greater(c_g, c_b)));
    const Floats green = 0.5f * c_g, others = 0.25f * (c_r + c_b);
    const Wide4 c = {(others + green) * scale, (0.5f * (c_r - c_b)) * scale, (green - others) * scale, (Floats)(0.0f)};
    return c;
}

INLINE Wide4 expanded(const Wide4 c, const float exposure) {
    const Floats none = 0.0f, rest = c.x - c.z;
    const Floats r = greater(rest + c.y, none), g = greater(c.x + c.z, none), b = greater(rest - c.y, none);
    const Floats most = 1.0f - greater(r, greater(g, b));
    const Floats scale = wide_divide((Floats)(1.0f), greater(most, (Floats)(1e-4f)) * exposure), top = COLOR_MAX;
    const Wide4 rgb = {lesser(r * scale, top), lesser(g * scale, top), lesser(b * scale, top), c.w};
    return rgb;
}

INLINE Ints within(const Floats px_x, const Floats px_y, const int width, const int height) {
    return (px_x >= 0.0f) & (px_y >= 0.0f) & (px_x < (float)width) & (px_y < (float)height);  /* not of NaN */
}

/* Where the nearest of the 3x3 pixels around each is, if that is of another surface than the pixel's own.
   Gives whether any is. */
INLINE bool nearest_around(const Span p, __global const float *depth, Ints *near_x, Ints *near_y) {
    const Floats own = beside(p, depth, 0, 0);
    Floats least_depth = own > 0.0f ? SAME_DEPTH * own : (Floats)(INFINITY);
    Ints dx = (Ints)(0), dy = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const Floats z = beside(p, depth, k % 3 - 1, k / 3 - 1);
        const Ints nearer = (z > 0.0f) & (z < least_depth);
        least_depth = nearer ? z : least_depth;
        dx = nearer ? (Ints)(k % 3 - 1) : dx;
        dy = nearer ? (Ints)(k / 3 - 1) : dy;
    }
    *near_x = clamp(p.x + LANE_NUMBERS + dx, (Ints)(0), (Ints)(p.width - 1));
    *near_y = clamp(p.y + dy, (Ints)(0), (Ints)(p.height - 1));
    return ANY((dx != 0) | (dy != 0));
}

/* How much of px in the image before was not hidden by something nearer than `expected`: bilinear. */
INLINE Floats share_seen(const Floats px_x, const Floats px_y, const Floats expected, const int width, const int height,
                         __global const float *previous_depth) {
    const Ints met = within(px_x, px_y, width, height);
    const Floats corner_x = met ? px_x - 0.5f : (Floats)(0.0f), corner_y = met ? px_y - 0.5f : (Floats)(0.0f);
    const Floats first_x = floor(corner_x), first_y = floor(corner_y), u = corner_x - first_x, v = corner_y - first_y;
    const Floats nearest = isinf(expected) ? (Floats)(MAXFLOAT) : SAME_DEPTH * expected;
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
INLINE Wide4 within_range(const Wide4 c, const Floats px_x, const Floats px_y, const int width, const int height,
                          __global const half *image) {
    int left[LANES], top[LANES];
    float low[4 * LANES], high[4 * LANES];
    store_ints(to_ints(floor(px_x - 0.5f)), 0, left);
    store_ints(to_ints(floor(px_y - 0.5f)), 0, top);
    for (int k = 0; k < LANES; ++k) {
        const float8 a = two_texels(image, left[k], top[k], width, height), b = two_texels(image, left[k], top[k] + 1, width, height);
        const float8 least = a < b ? a : b, most = a < b ? b : a;
        vstore4(least.lo < least.hi ? least.lo : least.hi, k, low);
        vstore4(most.lo < most.hi ? most.hi : most.lo, k, high);
    }
    const Wide4 l = channels_in(low), h = channels_in(high);
    const Wide4 clamped = {lesser(greater(c.x, l.x), h.x), lesser(greater(c.y, l.y), h.y), lesser(greater(c.z, l.z), h.z), c.w};
    return clamped;
}

/* Of each rendered pixel: where its surroundings were, and how far what it shows is from the history, seen there. */
WIDE __kernel void compare(
    const int target_width, const int target_height, const int source_width, const int source_height,
    const Reprojection to_previous, const float4 to_previous_display, const float exposure, const int has_history,
    __global const half *color, __global const float *depth, __global const float2 *motion,
    __global const float *previous_depth, __global const half *history, __global half *out_compressed,
    __global float2 *out_dilated, __global half *out_surprise) {
    const int x = get_global_id(0) * LANES, y = get_global_id(1), i = y * source_width + x, count = source_width - x;
    if (count <= 0 || y >= source_height) return;
    const Span p = {x, y, source_width, source_height,
                    x >= 1 && y >= 1 && x + LANES < source_width && y + 1 < source_height};
    Ints near_x, near_y;
    const bool elsewhere = nearest_around(p, depth, &near_x, &near_y);
    const Ints nearest = near_y * source_width + near_x;
    const Floats z = elsewhere ? gather_floats(depth, nearest) : beside(p, depth, 0, 0);
    Floats moved_y;
    const Floats moved_x = elsewhere ? gather_xy(motion, nearest, &moved_y) : xy_beside(p, motion, 0, 0, &moved_y);
    Floats seen = 0.0f;
    if (has_history) {
        const Floats centre_x = to_floats(near_x) + 0.5f, centre_y = to_floats(near_y) + 0.5f;
        const Wide3 v = wide_unproject(centre_x, centre_y, z, to_previous.source_inverse);
        const float4 forward = to_previous.row2;
        const Floats expected = forward.x * v.x + forward.y * v.y + forward.z * v.z + forward.w;
        const Floats share = share_seen(centre_x + moved_x, centre_y + moved_y, isinf(z) ? (Floats)(INFINITY) : expected,
                                        source_width, source_height, previous_depth);
        seen = z > 0.0f ? share : (Floats)(0.0f);
    }
    const Wide4 raw = gather_channels(color, clamped_beside(p, 0, 0));
    const Wide4 own = {finite(raw.x), finite(raw.y), finite(raw.z), (Floats)(0.0f)};
    Wide4 here = compressed_of(own.x, own.y, own.z, exposure), surprise = {(Floats)(0.0f), (Floats)(0.0f), (Floats)(0.0f), (Floats)(0.0f)};
    const Ints known = seen > 0.0f;
    if (ANY(known)) {
        const Floats px_x = (row_centres(x) + moved_x) * to_previous_display.x + to_previous_display.z;
        const Floats px_y = ((float)y + 0.5f + moved_y) * to_previous_display.y + to_previous_display.w;
        const Wide4 like = within_range(own, known ? px_x : (Floats)(0.0f), known ? px_y : (Floats)(0.0f), target_width, target_height,
                                        history);
        const Wide4 foretold = compressed_of(like.x, like.y, like.z, exposure);
        surprise.x = known ? here.x - foretold.x : (Floats)(0.0f);
        surprise.y = known ? here.y - foretold.y : (Floats)(0.0f);
        surprise.z = known ? here.z - foretold.z : (Floats)(0.0f);
        surprise.w = known ? (Floats)(1.0f) : (Floats)(0.0f);
    }
    here.w = seen;
    store_channels(here, count, out_compressed + 4 * i);
    store_some_xy(known ? moved_x : (Floats)(NAN), known ? moved_y : (Floats)(NAN), count, out_dilated + i);
    store_channels(surprise, count, out_surprise + 4 * i);
}

/* Sums over 3x3 pixels, of the channels and of their squares. */
INLINE void sums_beside(const Span p, __global const half *image, Floats *sum, Floats *square) {
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
    channels_of(&sums, sum);
    channels_of(&squares, square);
}

/* Colours around each rendered pixel, and how well the history foretold them: it may be darker or lighter than they are,
   which is made up for; what is left tells how far it is trusted. */
WIDE __kernel void survey(const int source_width, const int source_height, __global const half *compressed,
                          __global const half *surprise, __global half *out_mean, __global half *out_deviation) {
    const int x = get_global_id(0) * LANES, y = get_global_id(1), i = y * source_width + x, count = source_width - x;
    if (count <= 0 || y >= source_height) return;
    const Span p = {x, y, source_width, source_height,
                    x >= 1 && y >= 1 && x + LANES < source_width && y + 1 < source_height};
    const float ninth = 1.0f / 9.0f;
    Floats middle[4], square[4], off[4], off_square[4], variance[3];
    sums_beside(p, compressed, middle, square);
    sums_beside(p, surprise, off, off_square);
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        middle[c] *= ninth;
        variance[c] = greater(square[c] * ninth - middle[c] * middle[c], (Floats)(0.0f));
    }
    const Floats per_known = wide_divide((Floats)(1.0f), greater(off[3], (Floats)(1.0f)));
    const Floats bias = off[0] * per_known, scatter = greater(off_square[0] * per_known - bias * bias, (Floats)(0.0f));
    const Floats shift = bias * wide_divide(bias * bias, bias * bias + SCATTER * scatter + 1e-8f);
    const Floats missed = greater((off_square[0] + off_square[1] + off_square[2]) * per_known - shift * (2.0f * bias - shift), (Floats)(0.0f));
    const Floats error = sqrt(wide_divide(missed, variance[0] + variance[1] + variance[2] + NOISE * NOISE));
    const Floats trust = lesser(greater((WRONG - error) * (1.0f / (WRONG - RIGHT)), (Floats)(0.0f)), (Floats)(1.0f));
    const Floats seen = gather_channels(compressed, clamped_beside(p, 0, 0)).w;
    const Wide4 of_mean = {middle[0], middle[1], middle[2], trust * seen};
    const Wide4 deviation = {sqrt(variance[0]), sqrt(variance[1]), sqrt(variance[2]), shift};
    store_channels(of_mean, count, out_mean + 4 * i);
    store_channels(deviation, count, out_deviation + 4 * i);
}

/* Weight of samples `off` display pixels away. */
INLINE Floats sample_weight(const Floats off) {
    const Floats t = off * (1.0f / REACH), left = greater(1.0f - t * t, (Floats)(0.0f));
    return left * left;
}

/* The weighted sum of the 3x3 samples around pixel (x, y). */
inline float4 sum_around(const int x, const int y, const float3 wx, const float3 wy, const int width, const int height,
                         __global const half *compressed) {
    const float16 columns = wy.x * four_texels(compressed, x - 1, y - 1, width, height)
                            + wy.y * four_texels(compressed, x - 1, y, width, height)
                            + wy.z * four_texels(compressed, x - 1, y + 1, width, height);
    return wx.x * columns.s0123 + wx.y * columns.s4567 + wx.z * columns.s89ab;
}

/* The same of LANES pixels of a row, which share columns where pixels are small. */
INLINE Wide4 sums_around(const Ints x, const int y, const Floats *wx, const float3 wy, const int width, const int height,
                         __global const half *compressed) {
    float sums[4 * LANES], weights[3][LANES];
    int column[LANES];
    store_ints(x, 0, column);
    for (int k = 0; k < 3; ++k) store_floats(wx[k], 0, weights[k]);
#if LANES == 8
    const int first = column[0] - 1;
    if (column[7] - first <= 10) {
        float texels[48];
#pragma unroll
        for (int k = 0; k < 3; ++k)
            vstore16(wy.x * four_texels(compressed, first + 4 * k, y - 1, width, height)
                     + wy.y * four_texels(compressed, first + 4 * k, y, width, height)
                     + wy.z * four_texels(compressed, first + 4 * k, y + 1, width, height), k, texels);
        Strip s;
#pragma unroll
        for (int part = 0; part < PARTS; ++part) {
            const float *a = texels + 4 * (column[4 * part] - column[0]), *b = texels + 4 * (column[4 * part + 1] - column[0]),
                        *c = texels + 4 * (column[4 * part + 2] - column[0]), *d = texels + 4 * (column[4 * part + 3] - column[0]);
            s.part[part] = OF_TEXELS(wx[0], part) * (float16)(vload4(0, a), vload4(0, b), vload4(0, c), vload4(0, d))
                           + OF_TEXELS(wx[1], part) * (float16)(vload4(1, a), vload4(1, b), vload4(1, c), vload4(1, d))
                           + OF_TEXELS(wx[2], part) * (float16)(vload4(2, a), vload4(2, b), vload4(2, c), vload4(2, d));
        }
        Floats c[4];
        channels_of(&s, c);
        const Wide4 channels = {c[0], c[1], c[2], c[3]};
        return channels;
    }
#endif
    for (int k = 0; k < LANES; ++k)
        vstore4(sum_around(column[k], y, (float3)(weights[0][k], weights[1][k], weights[2][k]), wy, width, height, compressed), k, sums);
    return channels_in(sums);
}

/* The history that was found, in today's light, within a few deviations of the mean, and more where it is locked; how far it
   had to be moved there; the fourth channel: samples. `sum` of samples and their weight end locks. */
INLINE Wide4 bounded(const Wide4 found, const Wide4 mean, const Wide4 around, const Floats sum, const Floats weight,
                     const float exposure, Floats *locked, Floats *clipped) {
    Wide4 before = compressed_of(found.x, found.y, found.z, exposure);
    const Floats gain = wide_divide(greater(before.x + around.w, (Floats)(0.0f)), before.x + 1e-4f);
    before.x *= gain;
    before.y *= gain;
    before.z *= gain;
    const Floats own_room = DEVIATIONS * around.x + NOISE;
    const Ints contradicted = (weight > CLOSE) & (fabs(sum - weight * before.x) > weight * own_room);
    *locked = contradicted ? (Floats)(0.0f) : *locked;
    const Floats more_room = LOCKED_ROOM * (*locked * (1.0f / LOCK_FRAMES));
    const Floats room_x = own_room + more_room, room_y = DEVIATIONS * around.y + NOISE + more_room,
                 room_z = DEVIATIONS * around.z + NOISE + more_room;
    const Wide4 past = {lesser(greater(before.x, mean.x - room_x), mean.x + room_x),
                        lesser(greater(before.y, mean.y - room_y), mean.y + room_y),
                        lesser(greater(before.z, mean.z - room_z), mean.z + room_z), found.w};
    *clipped = fabs(past.x - before.x) + fabs(past.y - before.y) + fabs(past.z - before.z);
    return past;
}

/* The rendered frame into the history. */
WIDE __kernel void accumulate(
    const int target_width, const int target_height, const int source_width, const int source_height, const float4 to_render,
    const float2 pixel_size, const float4 to_previous_display, const float exposure, const int has_history,
    __global const half *compressed, __global const float2 *dilated, __global const half *mean,
    __global const half *deviation, __global const half *history, __global const uchar *lock, __global half *out_history,
    __global uchar *out_lock, __global uchar *rejected) {
    const int dst_x = get_global_id(0) * LANES, dst_y = get_global_id(1);
    const int dst = dst_y * target_width + dst_x, count = target_width - dst_x;
    if (count <= 0 || dst_y >= target_height) return;
    const Floats px_x = row_centres(dst_x) * to_render.x + to_render.z;
    const float px_y = ((float)dst_y + 0.5f) * to_render.y + to_render.w;
    const Ints x = clamp(to_ints(floor(px_x)), (Ints)(0), (Ints)(source_width - 1));
    const int y = clamp((int)floor(px_y), 0, source_height - 1);
    const Ints src = y * source_width + x;

    /* Samples near these pixels. */
    const Floats off_x = (to_floats(x) + 0.5f - px_x) * pixel_size.x, off_y = ((float)y + 0.5f - px_y) * pixel_size.y;
    const Floats wx[3] = {sample_weight(off_x - pixel_size.x), sample_weight(off_x), sample_weight(off_x + pixel_size.x)};
    const Floats wy[3] = {sample_weight(off_y - pixel_size.y), sample_weight(off_y), sample_weight(off_y + pixel_size.y)};
    const float3 wy3 = (float3)(FIRST_LANE(wy[0]), FIRST_LANE(wy[1]), FIRST_LANE(wy[2]));
    Wide4 sum = sums_around(x, y, wx, wy3, source_width, source_height, compressed);
    Floats total = (wx[0] + wx[1] + wx[2]) * (wy[0] + wy[1] + wy[2]);

    /* History: believed as far as it foretold the samples around, within their colours. */
    Floats moved_y;
    const Floats moved_x = gather_xy(dilated, src, &moved_y);
    const Floats px_previous_x = (px_x + moved_x) * to_previous_display.x + to_previous_display.z;
    const Floats px_previous_y = (px_y + moved_y) * to_previous_display.y + to_previous_display.w;
    const Ints known = within(px_previous_x, px_previous_y, target_width, target_height) & ((Ints)(has_history) != 0);
    Wide4 past = {(Floats)(0.0f), (Floats)(0.0f), (Floats)(0.0f), (Floats)(0.0f)};
    Floats held = 0.0f, locked = 0.0f, believed = 0.0f;
    if (ANY(known)) {
        const Wide4 middle = gather_channels(mean, src), around = gather_channels(deviation, src);
        const Ints near = to_ints(known ? px_previous_y : (Floats)(0.0f)) * target_width + to_ints(known ? px_previous_x : (Floats)(0.0f));
        const Floats trust = middle.w;
        const Floats agreed = lesser(to_floats(gather_bytes(lock, near)) + 1.0f, (Floats)(LOCK_FRAMES));
        locked = (known & (trust >= 1.0f)) ? agreed : (Floats)(0.0f);
        Floats clipped;
        past = bounded(cubic_at(known, px_previous_x, px_previous_y, target_width, target_height, history), middle, around,
                       sum.x, total, exposure, &locked, &clipped);
        believed = known ? trust * greater(1.0f - CLIPPED * clipped, (Floats)(0.0f)) : (Floats)(0.0f);
        held = lesser(past.w * believed, (Floats)(MOST_WEIGHT));
    }
    const Ints lacking = held < LEAST_WEIGHT;
    if (ANY(lacking)) {  /* until samples come, the frame itself fills in */
        const Wide4 fresh = cubic_in_row(lacking, px_x, px_y, source_width, source_height, compressed);
        const Floats part = FRESH * (1.0f - held * (1.0f / LEAST_WEIGHT)), share = known ? part : (Floats)(1.0f);
        past.x = lacking ? past.x + (fresh.x - past.x) * share : past.x;
        past.y = lacking ? past.y + (fresh.y - past.y) * share : past.y;
        past.z = lacking ? past.z + (fresh.z - past.z) * share : past.z;
        held = lacking ? (Floats)(LEAST_WEIGHT) : held;
    }
    total += held;
    const Floats scale = wide_divide((Floats)(1.0f), total);
    sum.x = (sum.x + held * past.x) * scale;
    sum.y = (sum.y + held * past.y) * scale;
    sum.z = (sum.z + held * past.z) * scale;
    sum.w = lesser(total, (Floats)(MOST_WEIGHT));
    store_channels(expanded(sum, exposure), count, out_history + 4 * dst);
    store_some_bytes(to_bytes(to_ints(locked)), count, out_lock + dst);
    store_some_bytes(to_bytes(to_ints(255.0f * (1.0f - believed) + 0.5f)), count, rejected + dst);
}

/* A generated frame: the history where its own fragments are seen, with what shading correction changed; else its own
   colour. */
WIDE __kernel void generate(const int target_width, const int target_height, const float4 to_shown, const int corrected,
                            __global const float *depth, __global const float2 *motion, __global const uchar *disoccluded,
                            __global const half *gae, __global const half *color, __global const half *history,
                            __global half *out_color) {
    const int x = get_global_id(0) * LANES, y = get_global_id(1), i = y * target_width + x, count = target_width - x;
    if (count <= 0 || y >= target_height) return;
    const Span p = {x, y, target_width, target_height,
                    x >= 1 && y >= 1 && x + LANES < target_width && y + 1 < target_height};
    Ints near_x, near_y;
    const bool elsewhere = nearest_around(p, depth, &near_x, &near_y);
    const Ints nearest = near_y * target_width + near_x;
    Floats moved_y;
    const Floats moved_x = elsewhere ? gather_xy(motion, nearest, &moved_y) : xy_beside(p, motion, 0, 0, &moved_y);
    const Floats centre_x = to_floats(near_x) + 0.5f, centre_y = to_floats(near_y) + 0.5f;
    const Floats px_x = row_centres(x) + ((centre_x + moved_x) * to_shown.x + to_shown.z - centre_x);
    const Floats px_y = ((float)y + 0.5f) + ((centre_y + moved_y) * to_shown.y + to_shown.w - centre_y);
    Ints uncovered = bytes_beside(p, disoccluded, 0, 0);
    if (elsewhere) uncovered |= to_ints(gather_bytes(disoccluded, nearest));
    const Ints seen = (uncovered == 0) & within(px_x, px_y, target_width, target_height);
    Wide4 shown = cubic_at(seen, px_x, px_y, target_width, target_height, history);
    const Ints own_i = clamped_beside(p, 0, 0);
    Wide4 own = shown;
    if (corrected || !ALL(seen)) {
        const Wide4 raw = gather_channels(color, own_i);
        own.x = finite(raw.x);
        own.y = finite(raw.y);
        own.z = finite(raw.z);
    }
    if (corrected) {
        const Wide4 before = gather_channels(gae, own_i);
        shown.x += own.x - finite(before.x);
        shown.y += own.y - finite(before.y);
        shown.z += own.z - finite(before.z);
    }
    const Floats none = 0.0f, top = COLOR_MAX;
    const Wide4 out = {seen ? lesser(greater(shown.x, none), top) : own.x, seen ? lesser(greater(shown.y, none), top) : own.y,
                       seen ? lesser(greater(shown.z, none), top) : own.z, none};
    store_channels(out, count, out_color + 4 * i);
}
