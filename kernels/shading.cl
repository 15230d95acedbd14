/* Around the shading correction network (paper: 'Shading Correction Network'): the previous rendered frame warped backward
   to t + alpha, the input mask, and the focus mask that it learns. Only pixels that move, or come from the image's border, are
   looked at one by one. */

#include "common.h"
#include "rgb.h"
#include "wide.h"

#define SAME_SURFACE 0.03f      /* relative depth within which the surface met in the previous frame is the fragment's ... */
#define DEPTH_PER_MOTION 2.0f   /* ... and what is added per unit of its sideways motion, as in history tracking */
#define LEAST_WEIGHT 0.25f      /* of the taps that show the surface */
#define MASK_DYNAMIC 1.0f
#define MASK_DISOCCLUDED 0.0f
#define MASK_REST 0.5f

/* Where pixel `centre` of the target was at t-1, if that is `as_static` (px in the previous image, depth there) for a static
   point, or one that was filled in; a dynamic one by the motion of both intervals. *tolerance in depth. */
inline float3 position_before(const float2 centre, const float3 as_static, const int is_dynamic, const float2 mv_px,
                              const int source_width, const int source_height, __global const float2 *motion,
                              const Reprojection to_previous, float *tolerance) {
    float3 before = as_static;
    *tolerance = SAME_SURFACE * before.z;
    if (!is_dynamic || !(before.z > 0.0f)) return before;
    const float2 px_now = centre + mv_px;
    const int src_x = (int)floor(px_now.x), src_y = (int)floor(px_now.y);
    if (!inside(src_x, src_y, source_width, source_height)) return (float3)(0.0f, 0.0f, -1.0f);
    const float2 mv_before = motion[src_y * source_width + src_x];
    if (!isfinite(mv_before.x) || !isfinite(mv_before.y)) return (float3)(0.0f, 0.0f, -1.0f);
    const float2 px_before = px_now + mv_before;
    const float sideways = (fabs(px_before.x - before.x) + fabs(px_before.y - before.y))
                           * divide(before.z, to_previous.target.x);
    *tolerance += DEPTH_PER_MOTION * sideways;
    before.xy = px_before;
    return before;
}

/* Colour of t-1 at a pixel's surface, of the taps that show it; false where they show too little of it. */
inline bool color_before(const float3 before, const float tolerance, const int source_width, const int source_height,
                         __global const half *color_prev, __global const float *depth_prev, float3 *rgb) {
    if (!(before.z > 0.0f && before.x > -1.0f && before.y > -1.0f && before.x < (float)source_width + 1.0f
          && before.y < (float)source_height + 1.0f)) return false;
    const float fx = before.x - 0.5f, fy = before.y - 0.5f;
    const int x0 = (int)floor(fx), y0 = (int)floor(fy);
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = x0 + (tap & 1), tap_y = y0 + (tap >> 1);
        if (!inside(tap_x, tap_y, source_width, source_height)) continue;
        if (!is_same_surface(depth_prev[tap_y * source_width + tap_x], before.z, tolerance)) continue;
        const float weight = bilinear_weight(tap, fx - (float)x0, fy - (float)y0);
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

/* The same for a run of pixels whose taps follow one another, four at a time, with valid = 1. */
inline bool store_sums_of_finite(const int first, const Floats *weight, const int width, __global const half *color,
                                 __global half *warped) {
    float16 sums[2];
    for (int part = 0; part < 2; ++part) {
        __global const half *top = color + 4 * (first + 4 * part), *bottom = top + 4 * width;
        float4 w[4];
        for (int tap = 0; tap < 4; ++tap) w[tap] = part ? weight[tap].hi : weight[tap].lo;
        sums[part] = (w[0].s0000111122223333 * vload_half16(0, top) + w[2].s0000111122223333 * vload_half16(0, bottom))
                     + (w[1].s0000111122223333 * vload_half16(0, top + 4) + w[3].s0000111122223333 * vload_half16(0, bottom + 4));
        if (!all(fabs(sums[part]) <= COLOR_MAX)) return false;
        sums[part].s37bf = (float4)(1.0f);
    }
    vstore_half16_rte(sums[0], 0, warped);
    vstore_half16_rte(sums[1], 1, warped);
    return true;
}

#else

inline bool store_sums_of_finite(const int first, const Floats *weight, const int width, __global const half *color,
                                 __global half *warped) { return false; }

#endif

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
    const Floats rest = hidden ? (Floats)(MASK_DISOCCLUDED) : (Floats)(MASK_REST);
    store_some_halfs(moves ? (Floats)(MASK_DYNAMIC) : rest, count, input_mask + dst);

    const Floats z = load_some_floats(count, depth + dst), px_y = (float)dst_y + 0.5f;
    const Wide3 before = wide_reproject(row_centres(dst_x), px_y, z, to_previous);
    const Floats fx = before.x - 0.5f, fy = before.y - 0.5f, tolerance = SAME_SURFACE * before.z;
    Ints inner = !moves & (before.z > 0.0f) & (fx >= 0.0f) & (fx < (float)(source_width - 1)) & (fy >= 0.0f)
                 & (fy < (float)(source_height - 1));
    if (!has_previous) inner = 0;
    const Ints x0 = to_ints(inner ? fx : (Floats)(0.0f)), y0 = to_ints(inner ? fy : (Floats)(0.0f));
    const Ints first = y0 * source_width + x0;
    const Floats u = fx - to_floats(x0), v = fy - to_floats(y0);
    const bool in_a_row = ALL(inner & (first == FIRST_LANE(first) + LANE_NUMBERS));
    Floats weight[4], weight_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const Ints at = inner ? first + (tap & 1) + (tap >> 1) * source_width : (Ints)(0);
        const Floats z_prev = in_a_row ? load_floats(0, depth_prev + FIRST_LANE(at)) : gather_floats(depth_prev, at);
        const Ints same = wide_is_same_surface(z_prev, before.z, tolerance);
        weight[tap] = same ? ((tap & 1) ? u : 1.0f - u) * ((tap >> 1) ? v : 1.0f - v) : (Floats)(0.0f);
        weight_sum += weight[tap];
    }
    const Floats scale = wide_divide((Floats)(1.0f), weight_sum);
    for (int tap = 0; tap < 4; ++tap) weight[tap] *= scale;
    if (count >= LANES && in_a_row && ALL(weight_sum >= LEAST_WEIGHT)
        && store_sums_of_finite(FIRST_LANE(first), weight, source_width, color_prev, warped_previous + 4 * dst)) return;
    int lane_first[LANES], lane_inner[LANES];
    float before_x[LANES], before_y[LANES], before_z[LANES], weights[4][LANES], weight_sums[LANES];
    store_ints(first, 0, lane_first);
    store_ints(inner, 0, lane_inner);
    store_floats(before.x, 0, before_x);
    store_floats(before.y, 0, before_y);
    store_floats(before.z, 0, before_z);
    store_floats(weight_sum, 0, weight_sums);
    for (int tap = 0; tap < 4; ++tap) store_floats(weight[tap], 0, weights[tap]);
    for (int k = 0; k < count; ++k) {
        float4 sum;
        const float4 taps = (float4)(weights[0][k], weights[1][k], weights[2][k], weights[3][k]);
        if (lane_inner[k] && !(weight_sums[k] >= LEAST_WEIGHT)) {
            vstore_half4_rte((float4)(load_color(color, dst + k), 0.0f), dst + k, warped_previous);
            continue;
        }
        if (lane_inner[k] && sum_of_finite(lane_first[k], taps, source_width, color_prev, &sum)) {
            vstore_half4_rte((float4)(sum.xyz, 1.0f), dst + k, warped_previous);
            continue;
        }
        const float3 as_static = (float3)(before_x[k], before_y[k], before_z[k]);
        float lane_tolerance;
        const float3 was = position_before(pixel_centre(dst_x + k, dst_y), as_static, is_dynamic[dst + k], out_motion[dst + k],
                                           source_width, source_height, motion, to_previous, &lane_tolerance);
        float3 rgb;
        const bool seen = has_previous && color_before(was, lane_tolerance, source_width, source_height, color_prev,
                                                       depth_prev, &rgb);
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
