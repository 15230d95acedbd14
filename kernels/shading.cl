/* Around the shading correction network (paper: 'Shading Correction Network'): the previous rendered frame warped backward
   to t + alpha, the input mask, and the focus mask that it learns. */

#include "common.h"
#include "rgb.h"

#define SAME_SURFACE 0.03f      /* relative depth within which the surface met in the previous frame is the fragment's ... */
#define DEPTH_PER_MOTION 2.0f   /* ... and what is added per unit of its sideways motion, as in history tracking */
#define MASK_DYNAMIC 1.0f
#define MASK_DISOCCLUDED 0.0f
#define MASK_REST 0.5f

/* Where pixel `centre` of the target was at t-1: (px in the previous image, depth there); *tolerance in depth.
   A static point, or one that was filled in, by its depth; a dynamic one by the motion of both intervals. */
inline float3 position_before(const float2 centre, const float z, const int is_dynamic, const float2 mv_px,
                              const int source_width, const int source_height, __global const float2 *motion,
                              const Reprojection to_previous, float *tolerance) {
    float3 before = reproject(centre, z, to_previous);
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

/* warped_previous: (colour of t-1 at this pixel's surface, 1), or (GAE colour, 0) where that was hidden or outside then. */
__kernel void prepare_inputs(const int target_width, const int target_height, const int source_width,
                             const int source_height,
                             const int has_previous, __global const half *color, __global const float *depth,
                             __global const float2 *out_motion, __global const uchar *is_dynamic,
                             __global const uchar *disoccluded, __global const float2 *motion,
                             __global const half *color_prev, __global const float *depth_prev,
                             const Reprojection to_previous, __global half *warped_previous, __global half *input_mask) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    vstore_half_rte(is_dynamic[dst] ? MASK_DYNAMIC : disoccluded[dst] ? MASK_DISOCCLUDED : MASK_REST, dst, input_mask);

    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f, tolerance;
    const float3 before = position_before(pixel_centre(dst_x, dst_y), depth[dst], is_dynamic[dst], out_motion[dst],
                                          source_width,
                                          source_height, motion, to_previous, &tolerance);
    if (has_previous && before.z > 0.0f && before.x > -1.0f && before.y > -1.0f && before.x < (float)source_width + 1.0f
        && before.y < (float)source_height + 1.0f) {
        const float fx = before.x - 0.5f, fy = before.y - 0.5f;
        const int x0 = (int)floor(fx), y0 = (int)floor(fy);
        const float u = fx - (float)x0, v = fy - (float)y0;
        for (int tap = 0; tap < 4; ++tap) {
            const int tap_x = x0 + (tap & 1), tap_y = y0 + (tap >> 1);
            if (!inside(tap_x, tap_y, source_width, source_height)) continue;
            const float z = depth_prev[tap_y * source_width + tap_x];
            if (!is_same_surface(z, before.z, tolerance)) continue;
            const float weight = bilinear_weight(tap, u, v);
            sum += weight * load_color(color_prev, tap_y * source_width + tap_x);
            weight_sum += weight;
        }
    }
    /* Two stores: Intel's vectoriser (2026.2) takes one decision for all lanes where a vector is selected before one store. */
    if (weight_sum >= 0.25f) {
        vstore_half4_rte((float4)(clamp(mean_of(sum, weight_sum), -COLOR_MAX, COLOR_MAX), 1.0f), dst, warped_previous);
    } else {
        vstore_half4_rte((float4)(load_color(color, dst), 0.0f), dst, warped_previous);
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
