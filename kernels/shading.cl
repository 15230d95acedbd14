/* Around the shading correction network (paper: 'Shading Correction Network'): the previous rendered frame warped backward
   to t + alpha, the input mask, and the focus mask that it learns. */

#include "common.h"
#include "rgb.h"

#define SAME_SURFACE 0.03f      /* relative depth within which the surface met in the previous frame is the fragment's ... */
#define DEPTH_PER_MOTION 2.0f   /* ... and what is added per unit of its sideways motion, as in history tracking */
#define MASK_DYNAMIC 1.0f
#define MASK_DISOCCLUDED 0.0f
#define MASK_REST 0.5f
#define FOCUS_SMAPE 0.5f        /* errors above this are the network's business ... */
#define SMAPE_EPSILON 0.01f     /* ... and this keeps black pixels from counting fully */

/* Where pixel `centre` of the target was at t-1: (px in the previous image, depth there); *tolerance in depth.
   A static point, or one that was filled in, by its depth; a dynamic one by the motion of both intervals. */
inline float3 position_before(const float2 centre, const float z, const int is_dynamic, const float2 mv_px,
                              const int width, const int height, __global const float2 *motion,
                              const Reprojection to_previous, float *tolerance) {
    float3 before = reproject(centre, z, to_previous);
    *tolerance = SAME_SURFACE * before.z;
    if (!is_dynamic || !(before.z > 0.0f)) return before;
    const float2 px_now = centre + mv_px;
    const int x = (int)floor(px_now.x), y = (int)floor(px_now.y);
    if (!inside(x, y, width, height)) return (float3)(0.0f, 0.0f, -1.0f);
    const float2 mv_before = motion[y * width + x];
    if (!isfinite(mv_before.x) || !isfinite(mv_before.y)) return (float3)(0.0f, 0.0f, -1.0f);
    const float2 px_before = px_now + mv_before;
    const float sideways = (fabs(px_before.x - before.x) + fabs(px_before.y - before.y))
                           * divide(before.z, to_previous.target.x);
    *tolerance += DEPTH_PER_MOTION * sideways;
    before.xy = px_before;
    return before;
}

/* warped_previous: (colour of t-1 at this pixel's surface, 1), or (GAE colour, 0) where that was hidden or outside then. */
__kernel void prepare_inputs(const int width, const int height, const int source_width, const int source_height,
                             const int has_previous, __global const half *color, __global const float *depth,
                             __global const float2 *out_motion, __global const uchar *is_dynamic,
                             __global const uchar *filled_by, __global const float2 *motion,
                             __global const half *color_prev, __global const float *depth_prev,
                             const Reprojection to_previous, __global half *warped_previous, __global half *input_mask) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height) return;
    const int i = y * width + x;
    const bool was_shown = filled_by[i] == BY_WARP || filled_by[i] == BY_CRACK_CLOSING;
    vstore_half_rte(is_dynamic[i] ? MASK_DYNAMIC : was_shown ? MASK_REST : MASK_DISOCCLUDED, i, input_mask);

    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f, tolerance;
    const float3 before = position_before(pixel_centre(x, y), depth[i], is_dynamic[i], out_motion[i], source_width,
                                          source_height, motion, to_previous, &tolerance);
    if (has_previous && before.z > 0.0f && before.x > -1.0f && before.y > -1.0f && before.x < (float)source_width + 1.0f
        && before.y < (float)source_height + 1.0f) {
        const float fx = before.x - 0.5f, fy = before.y - 0.5f;
        const int x0 = (int)floor(fx), y0 = (int)floor(fy);
        const float u = fx - (float)x0, v = fy - (float)y0;
        for (int tap = 0; tap < 4; ++tap) {
            const int tx = x0 + (tap & 1), ty = y0 + (tap >> 1);
            if (!inside(tx, ty, source_width, source_height)) continue;
            const float z = depth_prev[ty * source_width + tx];
            if (isinf(before.z) ? !isinf(z) : !(fabs(z - before.z) <= tolerance)) continue;
            const float weight = ((tap & 1) ? u : 1.0f - u) * ((tap >> 1) ? v : 1.0f - v);
            sum += weight * load_color(color_prev, ty * source_width + tx);
            weight_sum += weight;
        }
    }
    /* Two stores: Intel's vectoriser (2026.2) takes one decision for all lanes where a vector is selected before one store. */
    if (weight_sum >= 0.25f) {
        const float3 c = (float3)(divide(sum.x, weight_sum), divide(sum.y, weight_sum), divide(sum.z, weight_sum));
        vstore_half4_rte((float4)(clamp(c, -COLOR_MAX, COLOR_MAX), 1.0f), i, warped_previous);
    } else {
        vstore_half4_rte((float4)(load_color(color, i), 0.0f), i, warped_previous);
    }
}

inline float relative_error(const float a, const float b) {
    return divide(2.0f * fabs(a - b), fabs(a) + fabs(b) + SMAPE_EPSILON);
}

/* M_focus: 1 where the extrapolated colour is unlike the truth at this pixel and at its neighbours, and is not dynamic. */
__kernel void focus_mask(const int width, const int height, const float exposure, __global const uint2 *color /* half x4 */,
                         __global const uint2 *truth /* half x4 */, __global const uchar *is_dynamic,
                         __global uchar *focus_truth) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height) return;
    const int i = y * width + x;
    const Rgb c = load_rgb(color, i);
    float smallest = INFINITY;
    for (int ty = max(y - 1, 0); ty <= min(y + 1, height - 1); ++ty)
        for (int tx = max(x - 1, 0); tx <= min(x + 1, width - 1); ++tx) {
            const Rgb t = load_rgb(truth, ty * width + tx);
            const float sum = relative_error(exposure * c.r, exposure * t.r) + relative_error(exposure * c.g, exposure * t.g)
                              + relative_error(exposure * c.b, exposure * t.b);
            smallest = least(smallest, sum);
        }
    focus_truth[i] = smallest > 3.0f * FOCUS_SMAPE && !is_dynamic[i];
}
