/* Temporal anti-aliasing and upsampling: jittered frames of render size, gathered over time at the display's size.

   A mapping is (scale x, scale y, offset x, offset y) between pixel positions of two images of one pose. Colours are linear
   in `color` and `history`; means, bounds and blending are in YCoCg of tone-mapped colour (compressed, below).

   of          name             image     what
   in          color            render    rendered frame; jitter is in the mapping
               depth, motion    render    its depth, and motion into the previous render image
               previous_depth   render    of the rendered frame before
   between     compressed       render    its colour, tone-mapped YCoCg
               dilated          render    motion of the nearest surface in 3x3 pixels, NaN where it was not seen before
               mean, deviation  render    of 3x3 colours; A of deviation: whether a thin feature runs through the middle
   state       history          display   colour, linear
               weight, lock     display   how much is behind it; how long a thin feature is kept
   out         rejected         display   which share of the history was
               out_color        display   of a generated frame                                                              */

#include "common.h"
#include "rgb.h"
#include "cubic.h"

#define REACH 1.1f            /* display pixels: how far a sample counts */
#define MOST_WEIGHT 12.0f     /* samples' worth of history */
#define FRESH_WEIGHT 0.12f    /* of a colour that was only interpolated */
#define SPREAD 1.1f            /* standard deviations in which history is believed */
#define LOCKED_SPREAD 3.0f     /* the same, added where locked */
#define NOISE 0.02f           /* added to the deviation */
#define THIN 0.06f            /* contrast of a thin feature */
#define LOCK_FRAMES 8.0f
#define RIGHT 0.5f
#define WRONG 1.0f
#define CLIPPED 4.0f
#define SAME_DEPTH 0.04f      /* relative depth of one surface in two frames */
#define HUGE_DEPTH 1e30f

typedef struct { float y, o, g; } Ycocg;

inline float2 mapped(const float2 px, const float4 mapping) { return px * mapping.xy + mapping.zw; }

/* Tone-mapped by its largest channel: bright ones do not outweigh all others. */
inline Ycocg compressed_of(const Rgb c, const float exposure) {
    const float r = most(c.r, 0.0f) * exposure, g = most(c.g, 0.0f) * exposure, b = most(c.b, 0.0f) * exposure;
    const float scale = divide(1.0f, 1.0f + most(r, most(g, b)));
    const float half_rb = 0.25f * (r + b), half_g = 0.5f * g;
    const Ycocg made = {scale * (half_rb + half_g), scale * 0.5f * (r - b), scale * (half_g - half_rb)};
    return made;
}

inline Rgb expanded(const Ycocg c, const float exposure) {
    const float t = c.y - c.g;
    const float r = most(t + c.o, 0.0f), g = most(c.y + c.g, 0.0f), b = most(t - c.o, 0.0f);
    const float scale = divide(1.0f, most(1.0f - most(r, most(g, b)), 1e-4f) * exposure);
    const Rgb made = {r * scale, g * scale, b * scale};
    return made;
}

inline Ycocg load_compressed(__global const half *image, const int i) {
    const float4 c = vload_half4(i, image);
    const Ycocg made = {c.x, c.y, c.z};
    return made;
}

/* Cubic (Catmull-Rom) at px, clamped to the four inner taps; beyond the image its border goes on. */
inline Rgb cubic_at(const float2 px, const int width, const int height, __global const uint2 *color) {
    const float2 corner = px - 0.5f, first = floor(corner);
    const float4 wx = cubic_weights(corner.x - first.x), wy4 = cubic_weights(corner.y - first.y);
    const float wy[4] = {wy4.x, wy4.y, wy4.z, wy4.w};
    const int x = (int)first.x, y = (int)first.y, right = width - 1;
    const int x0 = clamp(x - 1, 0, right), x1 = clamp(x, 0, right), x2 = clamp(x + 1, 0, right), x3 = clamp(x + 2, 0, right);
    Rgb sum = {0.0f, 0.0f, 0.0f}, low = {INFINITY, INFINITY, INFINITY}, high = {-INFINITY, -INFINITY, -INFINITY};
    for (int k = 0; k < 4; ++k) {
        const int row = clamp(y + k - 1, 0, height - 1) * width;
        const Rgb a = load_rgb(color, row + x0), b = load_rgb(color, row + x1), c = load_rgb(color, row + x2),
                  d = load_rgb(color, row + x3);
        sum.r += wy[k] * (wx.x * a.r + wx.y * b.r + wx.z * c.r + wx.w * d.r);
        sum.g += wy[k] * (wx.x * a.g + wx.y * b.g + wx.z * c.g + wx.w * d.g);
        sum.b += wy[k] * (wx.x * a.b + wx.y * b.b + wx.z * c.b + wx.w * d.b);
        if (k == 0 || k == 3) continue;
        low.r = least(low.r, least(b.r, c.r));
        low.g = least(low.g, least(b.g, c.g));
        low.b = least(low.b, least(b.b, c.b));
        high.r = most(high.r, most(b.r, c.r));
        high.g = most(high.g, most(b.g, c.g));
        high.b = most(high.b, most(b.b, c.b));
    }
    const Rgb made = {least(most(sum.r, low.r), high.r), least(most(sum.g, low.g), high.g), least(most(sum.b, low.b), high.b)};
    return made;
}

/* How much of px in the previous image was not hidden by something nearer than `expected`: bilinear. */
inline float share_seen(const float2 px, const float expected, const int width, const int height,
                        __global const float *previous_depth) {
    if (!(px.x >= 0.0f && px.y >= 0.0f && px.x < (float)width && px.y < (float)height)) return 0.0f;
    const float2 corner = px - 0.5f, first = floor(corner), part = corner - first;
    const int x = (int)first.x, y = (int)first.y;
    const float nearest = isinf(expected) ? HUGE_DEPTH : (1.0f - SAME_DEPTH) * expected;
    float seen = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int i = clamp(y + (tap >> 1), 0, height - 1) * width + clamp(x + (tap & 1), 0, width - 1);
        if (!(previous_depth[i] < nearest)) seen += bilinear_weight(tap, part.x, part.y);
    }
    return seen;
}

/* Of each rendered pixel: where its surroundings were, and how far the history, seen there, is from what it shows. */
__kernel void compare(const int target_width, const int target_height, const int source_width, const int source_height,
                      const Reprojection to_previous, const float4 to_previous_display, const float exposure,
                      const int has_history, __global const uint2 *color, __global const float *depth,
                      __global const float2 *motion, __global const float *previous_depth, __global const uint2 *history,
                      __global half *out_compressed, __global float2 *out_dilated, __global half *out_seen) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= source_width || y >= source_height) return;
    const int i = y * source_width + x;
    int nearest = i;
    float nearest_depth = INVALID_DEPTH(depth[i]) ? INFINITY : depth[i];
    for (int k = 0; k < 9; ++k) {
        const int near_x = clamp(x + k % 3 - 1, 0, source_width - 1), near_y = clamp(y + k / 3 - 1, 0, source_height - 1);
        const int near = near_y * source_width + near_x;
        if (depth[near] > 0.0f && depth[near] < nearest_depth) {
            nearest = near;
            nearest_depth = depth[near];
        }
    }
    const float2 centre = pixel_centre(nearest % source_width, nearest / source_width), moved = motion[nearest];
    const float expected = reproject(centre, nearest_depth, to_previous).z;
    float seen = 0.0f;
    if (has_history && isfinite(moved.x) && isfinite(moved.y))
        seen = share_seen(centre + moved, expected, source_width, source_height, previous_depth);
    const Ycocg c = compressed_of(load_rgb(color, i), exposure);
    float error = 0.0f;
    if (seen > 0.0f) {
        const float2 px_previous = mapped(pixel_centre(x, y) + moved, to_previous_display);
        const Ycocg past = compressed_of(cubic_at(px_previous, target_width, target_height, history), exposure);
        const float dy = c.y - past.y, d_o = c.o - past.o, dg = c.g - past.g;
        error = dy * dy + d_o * d_o + dg * dg;
    }
    vstore_half4_rte((float4)(c.y, c.o, c.g, sqrt(error)), i, out_compressed);
    out_dilated[i] = seen > 0.0f ? moved : (float2)(NAN);
    vstore_half_rte(seen, i, out_seen);
}

/* Colours around each rendered pixel, and how well the history foretold them. */
__kernel void survey(const int source_width, const int source_height, __global const half *compressed,
                     __global half *out_mean, __global half *out_deviation) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= source_width || y >= source_height) return;
    const int i = y * source_width + x;
    float4 sum = (float4)(0.0f), squares = (float4)(0.0f);
    for (int k = 0; k < 9; ++k) {
        const int near_x = clamp(x + k % 3 - 1, 0, source_width - 1), near_y = clamp(y + k / 3 - 1, 0, source_height - 1);
        const float4 c = vload_half4(near_y * source_width + near_x, compressed);
        sum += c;
        squares += c * c;
    }
    const float ninth = 1.0f / 9.0f;
    const float4 mean = sum * ninth, variance = squares * ninth - mean * mean;
    const float spread = most(variance.x, 0.0f) + most(variance.y, 0.0f) + most(variance.z, 0.0f);
    const float off = divide(squares.w * ninth, spread + NOISE * NOISE);
    vstore_half4_rte((float4)(mean.xyz, 0.0f), i, out_mean);
    vstore_half4_rte((float4)(sqrt(most(variance.x, 0.0f)), sqrt(most(variance.y, 0.0f)), sqrt(most(variance.z, 0.0f)),
                              least(sqrt(off), 10.0f)), i, out_deviation);
}

/* Weight of a sample at (dx, dy) display pixels: 1 in the middle, 0 from REACH on. */
inline float weight_1d(const float d) {
    const float t = d * (1.0f / REACH), rest = most(1.0f - t * t, 0.0f);
    return rest * rest;
}

inline float bounded(const float value, const float mean, const float deviation) {
    return least(most(value, mean - deviation), mean + deviation);
}

/* The rendered frame into the history. */
__kernel void accumulate(const int target_width, const int target_height, const int source_width, const int source_height,
                         const float4 to_render, const float4 to_previous_display, const float exposure, const int has_history,
                         __global const uint2 *color, __global const half *compressed, __global const float2 *dilated,
                         __global const half *seen, __global const half *mean, __global const half *deviation, __global const uint2 *history,
                         __global const half *weight, __global const uchar *lock, __global half *out_history,
                         __global half *out_weight, __global uchar *out_lock, __global uchar *rejected) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    const float2 px_render = mapped(pixel_centre(dst_x, dst_y), to_render);
    const int x = clamp((int)floor(px_render.x), 0, source_width - 1), y = clamp((int)floor(px_render.y), 0, source_height - 1);
    const int src = y * source_width + x;

    /* Samples that fall near this pixel. */
    const float2 size = (float2)(divide(1.0f, to_render.x), divide(1.0f, to_render.y));
    float wx[3], wy[3];
    for (int k = 0; k < 3; ++k) {
        wx[k] = weight_1d(((float)(x + k) - 0.5f - px_render.x) * size.x);
        wy[k] = weight_1d(((float)(y + k) - 0.5f - px_render.y) * size.y);
    }
    Ycocg sum = {0.0f, 0.0f, 0.0f};
    float total = 0.0f;
    for (int k = 0; k < 9; ++k) {
        const float w = wx[k % 3] * wy[k / 3];
        if (!(w > 0.0f)) continue;
        const int near_x = clamp(x + k % 3 - 1, 0, source_width - 1), near_y = clamp(y + k / 3 - 1, 0, source_height - 1);
        const Ycocg c = load_compressed(compressed, near_y * source_width + near_x);
        sum.y += w * c.y;
        sum.o += w * c.o;
        sum.g += w * c.g;
        total += w;
    }

    /* History, believed within what the samples around allow, and as far as it foretold them. */
    const float2 px_previous = mapped(px_render + dilated[src], to_previous_display);
    const bool known = has_history && px_previous.x >= 0.0f && px_previous.y >= 0.0f && px_previous.x < (float)target_width
                       && px_previous.y < (float)target_height;
    float held = FRESH_WEIGHT, locked = 0.0f, refused = 1.0f;
    Ycocg past;
    if (known) {
        const float4 middle = vload_half4(src, mean), bounds = vload_half4(src, deviation);
        const int near = (int)px_previous.y * target_width + (int)px_previous.x;
        const float trust = least(most((WRONG - bounds.w) * (1.0f / (WRONG - RIGHT)), 0.0f), 1.0f) * vload_half(src, seen);
        locked = trust < 1.0f ? 0.0f : least((float)lock[near] + 1.0f, LOCK_FRAMES);
        const float spread = SPREAD + LOCKED_SPREAD * (locked * (1.0f / LOCK_FRAMES));
        past = compressed_of(cubic_at(px_previous, target_width, target_height, history), exposure);
        const Ycocg kept = {bounded(past.y, middle.x, spread * bounds.x + NOISE), bounded(past.o, middle.y, spread * bounds.y + NOISE),
                            bounded(past.g, middle.z, spread * bounds.z + NOISE)};
        const float off = fabs(kept.y - past.y) + fabs(kept.o - past.o) + fabs(kept.g - past.g);
        const float believed = trust * most(1.0f - CLIPPED * off, 0.0f);
        refused = 1.0f - believed;
        held = most(least(vload_half(near, weight) * believed, MOST_WEIGHT), FRESH_WEIGHT);
        past = kept;
    } else {
        past = compressed_of(cubic_at(px_render, source_width, source_height, color), exposure);
    }
    const float all = held + total, part = divide(1.0f, all);
    const Ycocg now = {(past.y * held + sum.y) * part, (past.o * held + sum.o) * part, (past.g * held + sum.g) * part};
    const Rgb shown = expanded(now, exposure);
    vstore_half4_rte((float4)(least(shown.r, COLOR_MAX), least(shown.g, COLOR_MAX), least(shown.b, COLOR_MAX), 0.0f), dst, out_history);
    vstore_half_rte(least(all, MOST_WEIGHT), dst, out_weight);
    out_lock[dst] = (uchar)locked;
    rejected[dst] = (uchar)(255.0f * refused + 0.5f);
}

/* A generated frame: history where its own fragments are, with what shading correction changed; else its own colour. */
__kernel void generate(const int target_width, const int target_height, const float4 to_shown, __global const float *depth,
                       __global const float2 *motion, __global const uchar *filled_by, __global const uchar *disoccluded,
                       __global const uint2 *gae, __global const uint2 *color, __global const uint2 *history,
                       __global half *out_color) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= target_width || y >= target_height) return;
    const int i = y * target_width + x;
    const Rgb own = load_rgb(color, i);
    int nearest = i;
    for (int k = 0; k < 9; ++k) {
        const int near_x = clamp(x + k % 3 - 1, 0, target_width - 1), near_y = clamp(y + k / 3 - 1, 0, target_height - 1);
        const int near = near_y * target_width + near_x;
        if (depth[near] < depth[nearest] && !disoccluded[near]) nearest = near;
    }
    const float2 centre = pixel_centre(nearest % target_width, nearest / target_width);
    const float2 px_shown = pixel_centre(x, y) + (mapped(centre + motion[nearest], to_shown) - centre);
    const bool known = !disoccluded[i] && px_shown.x >= 0.0f && px_shown.y >= 0.0f
                       && px_shown.x < (float)target_width && px_shown.y < (float)target_height;
    Rgb made = own;
    if (known) {
        const Rgb before = load_rgb(gae, i), past = cubic_at(px_shown, target_width, target_height, history);
        made.r = most(past.r + (own.r - before.r), 0.0f);
        made.g = most(past.g + (own.g - before.g), 0.0f);
        made.b = most(past.b + (own.b - before.b), 0.0f);
    }
    vstore_half4_rte((float4)(least(made.r, COLOR_MAX), least(made.g, COLOR_MAX), least(made.b, COLOR_MAX), 0.0f), i, out_color);
}
