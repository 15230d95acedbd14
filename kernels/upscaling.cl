/* Temporal anti-aliasing and upsampling: jittered frames of render size, gathered over time at the display's size.

   A mapping is (scale x, scale y, offset x, offset y) between pixel positions of two images of one pose; jitter is in them.
   Colours are linear in `color` and `history`; blending and bounds are in YCoCg of tone-mapped colour ("compressed").

              name             image     what
   in         color            render    the rendered frame
              depth, motion    render    its depth, and its motion into the render image before
              previous_depth   render    of the rendered frame before
   between    compressed       render    its colour, compressed; A: how far it is beyond the history around
              dilated          render    motion of the nearest surface around; NaN where that was hidden before
              mean             render    of 3x3 compressed colours; A: share of `dilated` that was not hidden before
              deviation        render    theirs; A: the error of the history around, in deviations
   state      history          display   colour, linear: what is shown; A: how many samples are behind it
              lock             display   frames in a row in which it foretold the samples
   out        rejected         display   which share of the history was not believed
              out_color        display   a generated frame, seen through the history                                       */

#include "common.h"
#include "cubic.h"

#define WHOLE_TEXELS __attribute__((vec_type_hint(float16)))  /* four texels at once: vectorised already */

#define REACH 1.1f            /* display pixels: from where on a sample does not count */
#define MOST_WEIGHT 12.0f     /* of the history, in samples */
#define LEAST_WEIGHT 0.3f     /* of what is shown until samples come */
#define FRESH 0.6f            /* share of the rendered frame in that; the rest is the history, clipped */
#define DEVIATIONS 1.3f         /* deviations from the mean that a history may have */
#define LOCKED_ROOM 0.5f      /* compressed colour beside that, after LOCK_FRAMES: thin features that no sample meets now */
#define LOCK_FRAMES 8.0f
#define NOISE 0.01f           /* of compressed colours, beside their deviation */
#define RIGHT 0.2f            /* deviations: error up to which the history is believed, and from which on it is not */
#define WRONG 0.5f
#define CLIPPED 4.0f          /* loss of belief by how much had to be clipped */
#define SAME_DEPTH 0.96f      /* relative depth from which on it is the same surface */

inline float2 mapped(const float2 px, const float4 mapping) { return px * mapping.xy + mapping.zw; }
inline float4 smaller(const float4 a, const float4 b) { return a < b ? a : b; }  /* of numbers */
inline float4 larger(const float4 a, const float4 b) { return a < b ? b : a; }
inline float largest(const float4 c) { return most(c.x, most(c.y, c.z)); }

/* Tone-mapped by the largest channel, so that bright samples do not outweigh all others; as (Y, Co, Cg, 0). */
inline float4 compressed_of(const float4 rgb, const float exposure) {
    const float4 c = larger(rgb, (float4)(0.0f)) * exposure;
    const float scale = divide(1.0f, 1.0f + largest(c)), green = 0.5f * c.y, others = 0.25f * (c.x + c.z);
    return (float4)(others + green, 0.5f * (c.x - c.z), green - others, 0.0f) * scale;
}

inline float4 expanded(const float4 c, const float exposure) {
    const float rest = c.x - c.z;
    const float4 rgb = larger((float4)(rest + c.y, c.x + c.z, rest - c.y, 0.0f), (float4)(0.0f));
    const float scale = divide(1.0f, most(1.0f - largest(rgb), 1e-4f) * exposure);
    return smaller(rgb * scale, (float4)(COLOR_MAX));
}

/* Texels x to x + 3 of a row; beyond the image its border goes on. */
inline float16 four_texels(__global const half *image, const int x, const int y, const int width, const int height) {
    const int row = clamp(y, 0, height - 1) * width;
    if (x >= 0 && x + 4 <= width) return vload_half16(0, image + 4 * (row + x));
    return (float16)(vload_half4(row + clamp(x, 0, width - 1), image), vload_half4(row + clamp(x + 1, 0, width - 1), image),
                     vload_half4(row + clamp(x + 2, 0, width - 1), image),
                     vload_half4(row + clamp(x + 3, 0, width - 1), image));
}

/* Catmull-Rom weights of four taps. */
inline float4 four_weights(const float t) {
    return (((float4)(-0.5f, 1.5f, -1.5f, 0.5f) * t + (float4)(1.0f, -2.5f, 2.0f, -0.5f)) * t
            + (float4)(-0.5f, 0.0f, 0.5f, 0.0f)) * t + (float4)(0.0f, 1.0f, 0.0f, 0.0f);
}

/* Cubic (Catmull-Rom) at px, clamped to the four inner taps. Of finite numbers. */
inline float4 cubic_at(const float2 px, const int width, const int height, __global const half *image) {
    const float2 corner = px - 0.5f, first = floor(corner);
    const float4 wx = four_weights(corner.x - first.x), wy = four_weights(corner.y - first.y);
    const int x = (int)first.x - 1, y = (int)first.y - 1;
    float4 sum;
    if (x >= 0 && y >= 0 && x + 4 <= width && y + 4 <= height) {
        __global const half *p = image + 4 * (y * width + x);
        return cubic_of_rows(vload_half16(0, p), vload_half16(0, p + 4 * width), vload_half16(0, p + 8 * width),
                             vload_half16(0, p + 12 * width), wx, wy, &sum);
    }
    return cubic_of_rows(four_texels(image, x, y, width, height), four_texels(image, x, y + 1, width, height),
                         four_texels(image, x, y + 2, width, height), four_texels(image, x, y + 3, width, height), wx, wy, &sum);
}

/* The least and the most of the 2x2 texels around px. */
inline void range_around(const float2 px, const int width, const int height, __global const half *image, float4 *low, float4 *high) {
    const int x = (int)floor(px.x - 0.5f), y = (int)floor(px.y - 0.5f);
    const float16 a = four_texels(image, x, y, width, height), b = four_texels(image, x, y + 1, width, height);
    *low = smaller(smaller(a.s0123, a.s4567), smaller(b.s0123, b.s4567));
    *high = larger(larger(a.s0123, a.s4567), larger(b.s0123, b.s4567));
}

inline bool within(const float2 px, const int width, const int height) {
    return px.x >= 0.0f && px.y >= 0.0f && px.x < (float)width && px.y < (float)height;  /* not of NaN */
}

/* Where the nearest of the 3x3 pixels around is, if that is of another surface than the pixel's own. */
inline int2 nearest_around(const int x, const int y, const int width, const int height, __global const float *depth) {
    const int i = y * width + x;
    float least_depth = INVALID_DEPTH(depth[i]) ? INFINITY : SAME_DEPTH * depth[i];
    int2 nearest = (int2)(x, y);
    if (x >= 1 && y >= 1 && x + 3 <= width && y + 2 <= height) {  /* four at once; mostly there is none */
        const float4 a = vload4(0, depth + i - width - 1), b = vload4(0, depth + i - 1), c = vload4(0, depth + i + width - 1);
        const int4 nearer = (a > 0.0f & a < least_depth) | (b > 0.0f & b < least_depth) | (c > 0.0f & c < least_depth);
        if (!any(nearer)) return nearest;
    }
    for (int near_y = max(y - 1, 0); near_y <= min(y + 1, height - 1); ++near_y)
        for (int near_x = max(x - 1, 0); near_x <= min(x + 1, width - 1); ++near_x) {
            const float z = depth[near_y * width + near_x];
            if (!(z > 0.0f && z < least_depth)) continue;
            least_depth = z;
            nearest = (int2)(near_x, near_y);
        }
    return nearest;
}

/* How much of px in the image before was not hidden by something nearer than `expected`: bilinear. */
inline float share_seen(const float2 px, const float expected, const int width, const int height,
                        __global const float *previous_depth) {
    if (!within(px, width, height)) return 0.0f;
    const float2 corner = px - 0.5f, first = floor(corner), part = corner - first;
    const float nearest = isinf(expected) ? MAXFLOAT : SAME_DEPTH * expected;
    float seen = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int x = clamp((int)first.x + (tap & 1), 0, width - 1), y = clamp((int)first.y + (tap >> 1), 0, height - 1);
        if (!(previous_depth[y * width + x] < nearest)) seen += bilinear_weight(tap, part.x, part.y);
    }
    return seen;
}

/* Of each rendered pixel: where its surroundings were, and how far what it shows is from the history, seen there. */
WHOLE_TEXELS __kernel void compare(
    const int target_width, const int target_height, const int source_width, const int source_height,
    const Reprojection to_previous, const float4 to_previous_display, const float exposure, const int has_history,
    __global const half *color, __global const float *depth, __global const float2 *motion,
    __global const float *previous_depth, __global const half *history, __global half *out_compressed,
    __global float2 *out_dilated, __global half *out_mean) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= source_width || y >= source_height) return;
    const int2 near = nearest_around(x, y, source_width, source_height, depth);
    const int i = y * source_width + x, nearest = near.y * source_width + near.x;
    const float2 centre = pixel_centre(near.x, near.y), moved = motion[nearest];
    float seen = 0.0f;
    if (has_history && !INVALID_DEPTH(depth[nearest])) {
        const float3 place = unproject(centre, depth[nearest], to_previous.source_inverse);
        const float expected = isinf(depth[nearest]) ? INFINITY : move_to_target(place, to_previous).z;
        seen = share_seen(centre + moved, expected, source_width, source_height, previous_depth);
    }
    const float4 own = (float4)(load_color(color, i), 0.0f), here = compressed_of(own, exposure);
    float error = 0.0f;
    if (seen > 0.0f) {
        const float2 px_previous = mapped(pixel_centre(x, y) + moved, to_previous_display);
        float4 low, high;
        range_around(px_previous, target_width, target_height, history, &low, &high);
        const float4 off = here - compressed_of(smaller(larger(own, low), high), exposure);
        error = off.x * off.x + off.y * off.y + off.z * off.z;
    }
    vstore_half4_rte((float4)(here.xyz, sqrt(error)), i, out_compressed);
    out_dilated[i] = seen > 0.0f ? moved : (float2)(NAN);
    vstore_half4_rte((float4)(0.0f, 0.0f, 0.0f, seen), i, out_mean);
}

/* Colours around each rendered pixel, and how well the history foretold them. */
WHOLE_TEXELS __kernel void survey(const int source_width, const int source_height, __global const half *compressed,
                                  __global half *mean, __global half *out_deviation) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= source_width || y >= source_height) return;
    const int i = y * source_width + x;
    const float16 a = four_texels(compressed, x - 1, y - 1, source_width, source_height),
                  b = four_texels(compressed, x - 1, y, source_width, source_height),
                  c = four_texels(compressed, x - 1, y + 1, source_width, source_height);
    const float16 sums = a + b + c, squares = a * a + b * b + c * c;
    const float ninth = 1.0f / 9.0f;
    const float4 middle = (sums.s0123 + sums.s4567 + sums.s89ab) * ninth;
    const float4 square = (squares.s0123 + squares.s4567 + squares.s89ab) * ninth;
    const float4 variance = larger(square - middle * middle, (float4)(0.0f));
    const float error = sqrt(divide(square.w, variance.x + variance.y + variance.z + NOISE * NOISE));
    vstore_half4_rte((float4)(middle.xyz, vload_half4(i, mean).w), i, mean);
    vstore_half4_rte((float4)(sqrt(variance.xyz), least(error, 10.0f)), i, out_deviation);
}

/* Weights of three samples, `step` apart, the middle one at `off` display pixels. */
inline float4 sample_weights(const float off, const float step) {
    const float4 t = (off + (float4)(-1.0f, 0.0f, 1.0f, 0.0f) * step) * (1.0f / REACH), rest = larger(1.0f - t * t, (float4)(0.0f));
    return rest * rest * (float4)(1.0f, 1.0f, 1.0f, 0.0f);
}

/* The rendered frame into the history. */
WHOLE_TEXELS __kernel void accumulate(
    const int target_width, const int target_height, const int source_width, const int source_height, const float4 to_render,
    const float2 pixel_size, const float4 to_previous_display, const float exposure, const int has_history,
    __global const half *compressed, __global const float2 *dilated, __global const half *mean,
    __global const half *deviation, __global const half *history, __global const uchar *lock, __global half *out_history,
    __global uchar *out_lock, __global uchar *rejected) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    const float2 px_render = mapped(pixel_centre(dst_x, dst_y), to_render);
    const int x = clamp((int)floor(px_render.x), 0, source_width - 1), y = clamp((int)floor(px_render.y), 0, source_height - 1);
    const int src = y * source_width + x;

    /* Samples near this pixel. */
    const float2 off = (pixel_centre(x, y) - px_render) * pixel_size;  /* display pixels */
    const float4 wx = sample_weights(off.x, pixel_size.x), wy = sample_weights(off.y, pixel_size.y);
    const float16 columns = wy.x * four_texels(compressed, x - 1, y - 1, source_width, source_height)
                            + wy.y * four_texels(compressed, x - 1, y, source_width, source_height)
                            + wy.z * four_texels(compressed, x - 1, y + 1, source_width, source_height);
    float4 sum = wx.x * columns.s0123 + wx.y * columns.s4567 + wx.z * columns.s89ab;
    float total = (wx.x + wx.y + wx.z) * (wy.x + wy.y + wy.z);

    /* History: believed as far as it foretold the samples around, within their colours. */
    const float2 px_previous = mapped(px_render + dilated[src], to_previous_display);
    const bool known = has_history && within(px_previous, target_width, target_height);
    float4 past = (float4)(0.0f);
    float held = 0.0f, locked = 0.0f, believed = 0.0f;
    if (known) {
        const float4 middle = vload_half4(src, mean), around = vload_half4(src, deviation);
        const int near = (int)px_previous.y * target_width + (int)px_previous.x;
        const float trust = least(most((WRONG - around.w) * (1.0f / (WRONG - RIGHT)), 0.0f), 1.0f) * middle.w;
        locked = trust < 1.0f ? 0.0f : least((float)lock[near] + 1.0f, LOCK_FRAMES);
        const float4 room = DEVIATIONS * around + NOISE + LOCKED_ROOM * (locked * (1.0f / LOCK_FRAMES));
        const float4 found = cubic_at(px_previous, target_width, target_height, history);
        const float4 before = compressed_of(found, exposure);
        past = smaller(larger(before, middle - room), middle + room);
        const float4 clipped = fabs(past - before);
        believed = trust * most(1.0f - CLIPPED * (clipped.x + clipped.y + clipped.z), 0.0f);
        held = least(found.w * believed, MOST_WEIGHT);
    }
    if (held < LEAST_WEIGHT) {  /* until samples come, the frame itself fills in */
        const float4 fresh = cubic_at(px_render, source_width, source_height, compressed);
        const float share = FRESH * (1.0f - held * (1.0f / LEAST_WEIGHT));
        past = known ? past + (fresh - past) * share : fresh;
        held = LEAST_WEIGHT;
    }
    total += held;
    sum = (sum + held * past) * divide(1.0f, total);
    vstore_half4_rte((float4)(expanded(sum, exposure).xyz, least(total, MOST_WEIGHT)), dst, out_history);
    out_lock[dst] = (uchar)locked;
    rejected[dst] = (uchar)(255.0f * (1.0f - believed) + 0.5f);
}

/* A generated frame: the history where its own fragments are seen, with what shading correction changed; else its own
   colour. */
WHOLE_TEXELS __kernel void generate(const int target_width, const int target_height, const float4 to_shown, const int corrected,
                                    __global const float *depth, __global const float2 *motion,
                                    __global const uchar *disoccluded, __global const half *gae, __global const half *color,
                                    __global const half *history, __global half *out_color) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= target_width || y >= target_height) return;
    const int i = y * target_width + x;
    if (!disoccluded[i]) {
        const int2 near = nearest_around(x, y, target_width, target_height, depth);
        const int nearest = near.y * target_width + near.x;
        const float2 centre = pixel_centre(near.x, near.y);
        const float2 px_shown = pixel_centre(x, y) + (mapped(centre + motion[nearest], to_shown) - centre);
        if (!disoccluded[nearest] && within(px_shown, target_width, target_height)) {
            float4 shown = cubic_at(px_shown, target_width, target_height, history);
            if (corrected) shown.xyz += load_color(color, i) - load_color(gae, i);
            vstore_half4_rte((float4)(smaller(larger(shown, (float4)(0.0f)), (float4)(COLOR_MAX)).xyz, 0.0f), i, out_color);
            return;
        }
    }
    store_color(load_color(color, i), out_color, i);
}
