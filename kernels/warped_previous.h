/* The previous rendered frame at pixels of the extrapolated one (paper: I^w and M^input of 'Shading Correction
   Network'), one at a time, or 2x2 at a time where they show one surface. */

#include "frame.h"
#include "simd_rgb.h"
#include "thresholds.h"

/* What set the thresholds: docs/deviations.md, "Previous frame only where its surface was shown". */
#define LEAST_WEIGHT 0.25f /* of the taps that show the surface */
#define MASK_DYNAMIC 1.0f
#define MASK_DISOCCLUDED 0.0f
#define MASK_REST 0.5f

/* The extrapolated frame, and the two rendered ones that its pixels are looked up in. */
typedef struct {
    __constant Frame *frame;
    __global const half *color, *color_prev;
    __global const float *depth, *depth_prev;
    __global const float2 *out_motion, *motion;
    __global const uchar *is_dynamic, *disoccluded;
} Frames;

/* Color of t-1 at a pixel's surface (see position_before), of the taps that show it; false where they show too
   little. */
INLINE bool color_before(const Frames *f, const float3 before, const float tolerance, float3 *rgb) {
    const int width = f->frame->source_width, x0 = (int)floor(before.x), y0 = (int)floor(before.y);
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int x = x0 + (tap & 1), y = y0 + (tap >> 1), i = y * width + x;
        if (!inside(x, y, width, f->frame->source_height)) continue;
        if (!is_same_surface(f->depth_prev[i], before.z, tolerance)) continue;
        const float weight = bilinear_weight(tap, before.x - (float)x0, before.y - (float)y0);
        sum += weight * load_color(f->color_prev, i);
        weight_sum += weight;
    }
    if (!(weight_sum >= LEAST_WEIGHT)) return false;
    *rgb = sum * (1.0f / weight_sum);
    return true;
}

/* The place where a static surface was at t-1: pixels of the previous image, and depth there, of `nearness` 1 / z,
   which is 0 for the sky. reproject of common.h with fewer divisions. */
#define DEFINE_PLACE_BEFORE(F, name)                                                                                   \
    INLINE void name(const F px_x, const float px_y, const F nearness, const Reprojection r, F *x, F *y, F *z) {       \
        const F view_x = (px_x - r.source_inverse.z) * r.source_inverse.x;                                             \
        const float view_y = (px_y - r.source_inverse.w) * r.source_inverse.y;                                         \
        const F depth = r.row2.x * view_x + (r.row2.y * view_y + r.row2.z) + r.row2.w * nearness;                      \
        const F per_depth = 1.0f / depth;                                                                              \
        *x = r.target.x * (r.row0.x * view_x + (r.row0.y * view_y + r.row0.z) + r.row0.w * nearness) * per_depth       \
             + r.target.z;                                                                                             \
        *y = r.target.y * (r.row1.x * view_x + (r.row1.y * view_y + r.row1.z) + r.row1.w * nearness) * per_depth       \
             + r.target.w;                                                                                             \
        *z = depth / nearness;                                                                                         \
    }

DEFINE_PLACE_BEFORE(float, place_before)
DEFINE_PLACE_BEFORE(Floats, wide_place_before)

/* I^w of a pixel: (color of t-1 at its surface, 1), or (GAE color, 0) where that was hidden or outside then. */
INLINE float4 previous_at(const Frames *f, const int x, const int y) {
    const int width = f->frame->source_width, height = f->frame->source_height, dst = y * f->frame->target_width + x;
    const float2 px = pixel_center(x, y);
    float x_before, y_before, z_before;
    place_before(px.x, px.y, 1.0f / f->depth[dst], f->frame->target_to_previous, &x_before, &y_before, &z_before);
    float3 before = (float3)(x_before, y_before, f->frame->has_previous ? z_before : -1.0f);
    float tolerance = SAME_SURFACE * before.z;
    if (f->is_dynamic[dst] && before.z > 0.0f) {
        const float2 now = px + f->out_motion[dst];
        const float2 mv = holds(width, height, now) ? f->motion[(int)now.y * width + (int)now.x] : (float2)(NAN);
        const float2 moved = now + mv;
        tolerance += DEPTH_PER_MOTION * (fabs(moved.x - before.x) + fabs(moved.y - before.y))
                     * (before.z / f->frame->target_to_previous.target.x);
        before = isfinite(mv.x) && isfinite(mv.y) ? (float3)(moved, before.z) : (float3)(-1.0f);
    }
    before.x -= 0.5f;
    before.y -= 0.5f;
    const bool met =
        before.z > 0.0f && before.x > -1.0f && before.x < (float)width && before.y > -1.0f && before.y < (float)height;
    float3 rgb;
    if (met && color_before(f, before, tolerance, &rgb)) return (float4)(clamp(rgb, -COLOR_MAX, COLOR_MAX), 1.0f);
    return (float4)(load_color(f->color, dst), 0.0f);
}

/* M^input of a pixel, and of LANES. */
INLINE float input_mask_at(const Frames *f, const int dst) {
    return f->is_dynamic[dst] ? MASK_DYNAMIC : f->disoccluded[dst] ? MASK_DISOCCLUDED : MASK_REST;
}

INLINE Floats input_masks(const Ints moves, const Ints hidden) {
    const Floats still = hidden ? (Floats)(MASK_DISOCCLUDED) : (Floats)(MASK_REST);
    return moves ? (Floats)(MASK_DYNAMIC) : still;
}

/* Where 2x2 pixels were at t-1, LANES times: if they are `smooth`, in the 3x3 texels from `tap` on, at (u, v) from one
   to the next, at depths from `nearest` to `farthest`. */
typedef struct {
    Ints smooth, tap;
    Floats u, v, nearest, farthest;
} Quads;

/* Replaces the places (x, y) of quads that move, by the motion of both intervals at their first pixels `at`. */
INLINE void follow_motion(const Frames *f, const Ints at, const Ints follows, const Floats px_x, const float px_y,
                          Wide3 *before, Floats *tolerance, Ints *smooth) {
    Floats out_y, mv_y;
    const Floats x = px_x + gather_xy(f->out_motion, at, &out_y), y = px_y + out_y;
    const int width = f->frame->source_width, height = f->frame->source_height;
    const Ints in_image = follows & (x >= 0.0f) & (x < (float)width) & (y >= 0.0f) & (y < (float)height);
    const Ints src = to_ints(in_image ? y : (Floats)(0.0f)) * width + to_ints(in_image ? x : (Floats)(0.0f));
    const Floats mv_x = gather_xy(f->motion, src, &mv_y);
    const Floats x_before = x + mv_x, y_before = y + mv_y;
    const Floats sideways =
        (fabs(x_before - before->x) + fabs(y_before - before->y)) * (before->z / f->frame->target_to_previous.target.x);
    *tolerance = follows ? *tolerance + DEPTH_PER_MOTION * sideways : *tolerance;
    before->x = follows ? x_before : before->x;
    before->y = follows ? y_before : before->y;
    *smooth &= !follows | (in_image & isfinite(mv_x) & isfinite(mv_y));
}

/* The quads of depths 1 / nearness[4], whose first pixels are `at`, around (px_x, px_y): all, some or none of the
   pixels move. They keep their shape: the previous frame is seen from close by. */
INLINE Quads find_quads(const Frames *f, const Ints at, const Floats px_x, const float px_y, const Floats *nearness,
                        const Ints all_move, const Ints some_move) {
    const int width = f->frame->source_width, height = f->frame->source_height;
    const Floats mean = 0.25f * ((nearness[0] + nearness[1]) + (nearness[2] + nearness[3]));
    const Floats least = wide_lesser(wide_lesser(nearness[0], nearness[1]), wide_lesser(nearness[2], nearness[3]));
    const Floats most = wide_greater(wide_greater(nearness[0], nearness[1]), wide_greater(nearness[2], nearness[3]));
    Wide3 before;
    wide_place_before(px_x, px_y, mean, f->frame->target_to_previous, &before.x, &before.y, &before.z);
    Floats tolerance = SAME_SURFACE * before.z;
    Ints smooth = (all_move | !some_move) & (most - least <= SAME_SURFACE * mean) & (before.z > 0.0f);
    if (ANY(all_move)) follow_motion(f, at, all_move, px_x, px_y, &before, &tolerance, &smooth);
    const Floats left = before.x - 1.0f, top = before.y - 1.0f;
    smooth &= (left >= 0.0f) & (left < (float)(width - 2)) & (top >= 0.0f) & (top < (float)(height - 2));
    const Ints x0 = to_ints(smooth ? left : (Floats)(0.0f)), y0 = to_ints(smooth ? top : (Floats)(0.0f));
    Quads q;
    q.smooth = smooth;
    q.tap = y0 * width + x0;
    q.u = left - to_floats(x0);
    q.v = top - to_floats(y0);
    q.nearest = isinf(before.z) ? before.z : before.z - tolerance;
    q.farthest = before.z + tolerance;
    return q;
}

/* Whether depths, three of a row from index `tap` on, are of the surface between two: -1 or 0. */
INLINE int3 of_surface(__global const float *depth, const int tap, const float nearest, const float farthest) {
    const float3 z = vload3(0, depth + tap);
    return (z >= nearest) & (z <= farthest);
}

/* Colors between three texels of a row from index `tap` on: of the left and of the right pixel. */
INLINE float8 between_texels(__global const half *color, const int tap, const float u) {
    const float8 left = load_two_texels(tap, color), right = load_two_texels(tap + 1, color);
    return left + u * (right - left);
}

/* The same times the weights of those that are of the surface; and their `weight`. */
INLINE float8 between_some(__global const half *color, const int tap, const float u, const int3 same, float8 *weight) {
    const float3 is = same ? (float3)(1.0f) : (float3)(0.0f);
    const float8 left = (1.0f - u) * (float8)(is.xxxx, is.yyyy), right = u * (float8)(is.yyyy, is.zzzz);
    *weight = left + right;
    return left * load_two_texels(tap, color) + right * load_two_texels(tap + 1, color);
}

/* I^w of a row of a quad, between rows of texels; where they hardly show its surface the GAE colors from `dst` on. */
INLINE float8 mean_of_some(const Frames *f, const int dst, const float v, const float8 top, const float8 bottom,
                           const float8 top_weight, const float8 bottom_weight) {
    const float8 weight = top_weight + v * (bottom_weight - top_weight), sum = top + v * (bottom - top);
    const int8 shown = weight >= LEAST_WEIGHT;
    const float8 mean = sum / (shown ? weight : (float8)(1.0f));
    if (all(shown)) return mean;
    return shown ? mean : load_two_texels(dst, f->color);
}
