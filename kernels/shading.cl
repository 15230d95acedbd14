/* Around the shading correction network (paper: 'Shading Correction Network'): the previous rendered frame warped backward
   to t + alpha, the input mask, and the focus mask that it learns. Only pixels whose taps lie apart from their neighbours', or
   at the image's border, are looked at one by one. */

#include "common.h"
#include "rgb.h"
#include "wide.h"

#define SAME_SURFACE 0.03f      /* relative depth within which the surface met in the previous frame is the fragment's ... */
#define DEPTH_PER_MOTION 2.0f   /* ... and what is added per unit of its sideways motion, as in history tracking */
#define LEAST_WEIGHT 0.25f      /* of the taps that show the surface */
#define MASK_DYNAMIC 1.0f
#define MASK_DISOCCLUDED 0.0f
#define MASK_REST 0.5f

/* Colour of t-1 at a pixel's surface (see position_before), of the taps that show it; false where they show too little. */
inline bool color_before(const float3 before, const float tolerance, const int source_width, const int source_height,
                         __global const half *color_prev, __global const float *depth_prev, float3 *rgb) {
    const int x0 = (int)floor(before.x), y0 = (int)floor(before.y);
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = x0 + (tap & 1), tap_y = y0 + (tap >> 1);
        if (!inside(tap_x, tap_y, source_width, source_height)) continue;
        if (!is_same_surface(depth_prev[tap_y * source_width + tap_x], before.z, tolerance)) continue;
        const float weight = bilinear_weight(tap, before.x - (float)x0, before.y - (float)y0);
        sum += weight * load_color(color_prev, tap_y * source_width + tap_x);
        weight_sum += weight;
    }
    if (!(weight_sum >= LEAST_WEIGHT)) return false;
    *rgb = mean_of(sum, weight_sum);
    return true;
}

/* Weighted sum of the 2x2 pixels from index `first` on, two of a row at a time; false where one is no finite number. */
inline bool sum_of_finite(const int first, const float4 weights, const int width, __global const half *color, float4 *rgb) {
    const float8 top = vload_half8(0, color + 4 * first), bottom = vload_half8(0, color + 4 * (first + width));
    const float8 columns = (float8)((float4)(weights.x), (float4)(weights.y)) * top
                           + (float8)((float4)(weights.z), (float4)(weights.w)) * bottom;
    *rgb = columns.lo + columns.hi;
    return fabs((*rgb).x) <= COLOR_MAX && fabs((*rgb).y) <= COLOR_MAX && fabs((*rgb).z) <= COLOR_MAX;
}

#if LANES == 8

/* The same of four pixels whose taps follow one another. */
inline float16 sum_of_four(const int first, const float4 *w, const int width, __global const half *color) {
    __global const half *top = color + 4 * first, *bottom = top + 4 * width;
    return (w[0].s0000111122223333 * vload_half16(0, top) + w[2].s0000111122223333 * vload_half16(0, bottom))
           + (w[1].s0000111122223333 * vload_half16(0, top + 4) + w[3].s0000111122223333 * vload_half16(0, bottom + 4));
}

/* The same for a strip of pixels, with valid = 1: their taps are the pixels from `first` on, or from `second` on. Those that
   are `lost` get (GAE colour, 0). */
inline bool store_strip(const int first, const int second, const Ints in_second, const Ints lost, const Floats *weight,
                        const int width, __global const half *color_prev, __global const half *color, __global half *warped) {
    float16 sums[2];
#pragma unroll
    for (int part = 0; part < 2; ++part) {
        float4 w[4];
#pragma unroll
        for (int tap = 0; tap < 4; ++tap) w[tap] = part ? weight[tap].hi : weight[tap].lo;
        sums[part] = sum_of_four(first + 4 * part, w, width, color_prev);
        if (second != first) {
            const int4 other = part ? in_second.hi : in_second.lo;
            sums[part] = other.s0000111122223333 ? sum_of_four(second + 4 * part, w, width, color_prev) : sums[part];
        }
        sums[part].s37bf = (float4)(1.0f);
        if (ANY(lost)) {
            const int4 here = part ? lost.hi : lost.lo;
            float16 gae = vload_half16(part, color);
            gae.s37bf = (float4)(0.0f);
            sums[part] = here.s0000111122223333 ? gae : sums[part];
        }
    }
    if (!all((fabs(sums[0]) <= COLOR_MAX) & (fabs(sums[1]) <= COLOR_MAX))) return false;
    vstore_half16_rte(sums[0], 0, warped);
    vstore_half16_rte(sums[1], 1, warped);
    return true;
}

#else

inline bool store_strip(const int first, const int second, const Ints in_second, const Ints lost, const Floats *weight,
                        const int width, __global const half *color_prev, __global const half *color, __global half *warped) {
    return false;
}

#endif

/* Where pixels of a row, of depth z, were at t-1 if they are static or were filled in: pixels of the previous image, less half
   a pixel, and depth there. reproject of common.h with fewer divisions. */
inline Wide3 position_before(const Floats px_x, const float px_y, const Floats z, const Reprojection r) {
    const Floats x = (px_x - r.source_inverse.z) * r.source_inverse.x, nearness = 1.0f / z;  /* of the sky: 0 */
    const float y = (px_y - r.source_inverse.w) * r.source_inverse.y;
    const Floats depth = r.row2.x * x + (r.row2.y * y + r.row2.z) + r.row2.w * nearness, per_depth = 1.0f / depth;
    Wide3 before;
    before.x = r.target.x * (r.row0.x * x + (r.row0.y * y + r.row0.z) + r.row0.w * nearness) * per_depth + (r.target.z - 0.5f);
    before.y = r.target.y * (r.row1.x * x + (r.row1.y * y + r.row1.z) + r.row1.w * nearness) * per_depth + (r.target.w - 0.5f);
    before.z = depth * z;
    return before;
}

/* The same of those that move, by the motion of both intervals: z is -1 where it is unknown. *tolerance in depth. */
inline void follow_motion(const Ints moves, const Floats px_x, const Floats px_y, const Floats mv_x, const Floats mv_y,
                          const int source_width, const int source_height, __global const float2 *motion, const float focal,
                          Wide3 *before, Floats *tolerance) {
    const Floats x = px_x + mv_x, y = px_y + mv_y;
    const Ints in_image = (x >= 0.0f) & (x < (float)source_width) & (y >= 0.0f) & (y < (float)source_height);
    const Ints follows = moves & (before->z > 0.0f) & in_image;
    const Ints at = to_ints(follows ? y : (Floats)(0.0f)) * source_width + to_ints(follows ? x : (Floats)(0.0f));
    const Floats mv_before_x = gather_floats((__global const float *)motion, 2 * at);
    const Floats mv_before_y = gather_floats((__global const float *)motion, 2 * at + 1);
    const Ints known = follows & isfinite(mv_before_x) & isfinite(mv_before_y);
    const Floats x_before = x + mv_before_x - 0.5f, y_before = y + mv_before_y - 0.5f;
    const Floats sideways = (fabs(x_before - before->x) + fabs(y_before - before->y)) * (before->z / focal);
    *tolerance = known ? *tolerance + DEPTH_PER_MOTION * sideways : *tolerance;
    before->x = known ? x_before : before->x;
    before->y = known ? y_before : before->y;
    before->z = (!moves | known) ? before->z : (Floats)(-1.0f);
}

/* warped_previous: (colour of t-1 at this pixel's surface, 1), or (GAE colour, 0) where that was hidden or outside then. */
WIDE __kernel void prepare_inputs(const int target_width, const int target_height, const int source_width,
                                  const int source_height, const int has_previous, __global const half *color,
                                  __global const float *depth, __global const float2 *out_motion,
                                  __global const uchar *is_dynamic, __global const uchar *disoccluded,
                                  __global const float2 *motion, __global const half *color_prev,
                                  __global const float *depth_prev, const Reprojection to_previous,
                                  __global half *warped_previous, __global half *input_mask) {
    const int dst_x = get_global_id(0) * LANES, dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x, count = min(target_width - dst_x, LANES);
    const Ints moves = to_ints(load_some_bytes(count, is_dynamic + dst)) != 0;
    const Ints hidden = to_ints(load_some_bytes(count, disoccluded + dst)) != 0;
    const Floats still = hidden ? (Floats)(MASK_DISOCCLUDED) : (Floats)(MASK_REST);
    store_some_halfs(moves ? (Floats)(MASK_DYNAMIC) : still, count, input_mask + dst);

    const Floats px_x = row_centres(dst_x), px_y = (float)dst_y + 0.5f;
    Wide3 before = position_before(px_x, (float)dst_y + 0.5f, load_some_floats(count, depth + dst), to_previous);
    Floats tolerance = SAME_SURFACE * before.z;
    if (ANY(moves)) {
        Floats mv_y;
        const Floats mv_x = load_some_xy(count, out_motion + dst, &mv_y);
        follow_motion(moves, px_x, px_y, mv_x, mv_y, source_width, source_height, motion, to_previous.target.x, &before,
                      &tolerance);
    }
    if (!has_previous) before.z = -1.0f;
    const Ints inner = (before.z > 0.0f) & (before.x >= 0.0f) & (before.x < (float)(source_width - 1)) & (before.y >= 0.0f)
                       & (before.y < (float)(source_height - 1));
    const Ints x0 = to_ints(inner ? before.x : (Floats)(0.0f)), y0 = to_ints(inner ? before.y : (Floats)(0.0f));
    const Ints tap_0 = y0 * source_width + x0;
    const Floats u = before.x - to_floats(x0), v = before.y - to_floats(y0);

    /* The taps of most strips follow one another but for one jump, which the ends tell. */
    const int first = FIRST_LANE(tap_0), last = LAST_LANE(tap_0) - (LANES - 1), second = last >= 0 ? last : first;
    const Ints in_first = tap_0 == first + LANE_NUMBERS, in_second = !in_first & (tap_0 == second + LANE_NUMBERS);
    const Ints in_runs = inner & (in_first | in_second);
    const bool in_image = max(first, second) + LANES + source_width < source_width * source_height;
    const bool all_in_runs = in_image && ALL(in_runs | !inner);
    const Floats nearest = isinf(before.z) ? before.z : before.z - tolerance, farthest = before.z + tolerance;
    Floats weight[4], weight_sum = 0.0f;
#pragma unroll
    for (int tap = 0; tap < 4; ++tap) {
        const int step = (tap & 1) + (tap >> 1) * source_width;
        Floats z_prev;
        if (all_in_runs) {
            z_prev = load_floats(0, depth_prev + first + step);
            if (second != first) z_prev = in_second ? load_floats(0, depth_prev + second + step) : z_prev;
        } else {
            const Ints at = inner ? tap_0 + step : (Ints)(0);
            z_prev = gather_floats(depth_prev, at);
        }
        const Ints same = inner & (z_prev >= nearest) & (z_prev <= farthest);
        weight[tap] = same ? ((tap & 1) ? u : 1.0f - u) * ((tap >> 1) ? v : 1.0f - v) : (Floats)(0.0f);
        weight_sum += weight[tap];
    }
    const Ints shown = weight_sum >= LEAST_WEIGHT;
    if (!ALL(weight_sum > 0.99999f)) {
        const Floats scale = shown ? 1.0f / weight_sum : (Floats)(0.0f);
#pragma unroll
        for (int tap = 0; tap < 4; ++tap) weight[tap] *= scale;
    }
    const Ints met = (before.z > 0.0f) & (before.x > -1.0f) & (before.x < (float)source_width) & (before.y > -1.0f)
                     & (before.y < (float)source_height);
    const Ints lost = !met | (inner & !shown);
    Ints rest = !lost & !(shown & in_runs);
    if (count < LANES || !in_image || ALL(rest)
        || !store_strip(first, second, in_second, lost, weight, source_width, color_prev, color + 4 * dst,
                        warped_previous + 4 * dst)) rest = 1;
    if (!ANY(rest != 0)) return;
    int lane_first[LANES], lane_inner[LANES], lane_lost[LANES], lane_rest[LANES];
    float before_x[LANES], before_y[LANES], before_z[LANES], tolerances[LANES], weights[4][LANES];
    store_ints(tap_0, 0, lane_first);
    store_ints(inner, 0, lane_inner);
    store_ints(lost, 0, lane_lost);
    store_ints(rest, 0, lane_rest);
    store_floats(before.x, 0, before_x);
    store_floats(before.y, 0, before_y);
    store_floats(before.z, 0, before_z);
    store_floats(tolerance, 0, tolerances);
    for (int tap = 0; tap < 4; ++tap) store_floats(weight[tap], 0, weights[tap]);
    for (int k = 0; k < count; ++k) {
        if (!lane_rest[k]) continue;
        float4 sum;
        const float4 taps = (float4)(weights[0][k], weights[1][k], weights[2][k], weights[3][k]);
        if (lane_lost[k]) {
            vstore_half4_rte((float4)(load_color(color, dst + k), 0.0f), dst + k, warped_previous);
            continue;
        }
        if (lane_inner[k] && sum_of_finite(lane_first[k], taps, source_width, color_prev, &sum)) {
            vstore_half4_rte((float4)(sum.xyz, 1.0f), dst + k, warped_previous);
            continue;
        }
        float3 rgb;
        const bool seen = color_before((float3)(before_x[k], before_y[k], before_z[k]), tolerances[k], source_width,
                                       source_height, color_prev, depth_prev, &rgb);
        /* Stores of their own per case: Intel's vectoriser (2026.2) takes one decision for all lanes where a vector is selected
           before one store. */
        if (seen) {
            vstore_half4_rte((float4)(clamp(rgb, -COLOR_MAX, COLOR_MAX), 1.0f), dst + k, warped_previous);
        } else {
            vstore_half4_rte((float4)(load_color(color, dst + k), 0.0f), dst + k, warped_previous);
        }
    }
}

inline float relative_error(const float a, const float b, const float epsilon) {
    return divide(2.0f * fabs(a - b), fabs(a) + fabs(b) + epsilon);
}

/* M_focus: 1 where the extrapolated colour is unlike the truth at this pixel and at its neighbours (SMAPE over focus_smape), and
   is not dynamic; smape_epsilon keeps black pixels from counting fully. */
__kernel void focus_mask(const int target_width, const int target_height, const float exposure, const float focus_smape,
                         const float smape_epsilon, __global const uint2 *color /* half x4 */,
                         __global const uint2 *truth /* half x4 */, __global const uchar *is_dynamic,
                         __global uchar *focus_truth) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    const Rgb c = load_rgb(color, dst);
    float smallest = INFINITY;
    for (int near_y = max(dst_y - 1, 0); near_y <= min(dst_y + 1, target_height - 1); ++near_y)
        for (int near_x = max(dst_x - 1, 0); near_x <= min(dst_x + 1, target_width - 1); ++near_x) {
            const Rgb t = load_rgb(truth, near_y * target_width + near_x);
            const float sum = relative_error(exposure * c.r, exposure * t.r, smape_epsilon)
                              + relative_error(exposure * c.g, exposure * t.g, smape_epsilon)
                              + relative_error(exposure * c.b, exposure * t.b, smape_epsilon);
            smallest = least(smallest, sum);
        }
    focus_truth[dst] = smallest > 3.0f * focus_smape && !is_dynamic[dst];
}
