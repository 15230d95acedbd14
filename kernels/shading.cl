/* Inputs of the shading correction network (paper: 'Shading Correction Network'): the previous rendered frame,
   warped, at full size for display, and the focus mask for training. */

#include "frame.h"
#include "warped_previous.h"
#include "rgb.h"

#define FOCUS_SMAPE 0.5f     /* the paper's: errors above this are the shading correction network's business */
#define SMAPE_EPSILON 0.01f  /* the paper's: keeps black pixels from counting fully */

/* warped_previous and input_mask. network_input (correction.cl) does not need them: it has the same from
   warped_previous.h. */
__kernel void prepare_inputs(__constant Frame *restrict frame, __global const half *color, __global const float *depth,
                             __global const float2 *out_motion, __global const uchar *is_dynamic,
                             __global const uchar *disoccluded, __global const float2 *motion,
                             __global const half *color_prev, __global const float *depth_prev,
                             __global half *warped_previous, __global half *input_mask) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1), dst = dst_y * frame->target_width + dst_x;
    if (dst_x >= frame->target_width || dst_y >= frame->target_height) return;
    const Frames frames = {frame, color, color_prev, depth, depth_prev, out_motion, motion, is_dynamic, disoccluded};
    vstore_half_rte(input_mask_at(&frames, dst), dst, input_mask);
    store_texel(previous_at(&frames, dst_x, dst_y), dst, warped_previous);
}

INLINE float relative_error(const float a, const float b) {
    return divide(2.0f * fabs(a - b), fabs(a) + fabs(b) + SMAPE_EPSILON);
}

/* M_focus: 1 where the extrapolated color is unlike the truth at this pixel and at its neighbors (SMAPE over
   FOCUS_SMAPE), and is not dynamic. */
__kernel void focus_mask(const int target_width, const int target_height, const float exposure,
                         __global const uint2 *color /* half x4 */, __global const uint2 *truth /* half x4 */,
                         __global const uchar *is_dynamic, __global uchar *focus_truth) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    const Rgb c = load_rgb(color, dst);
    float smallest = INFINITY;
    for (int near_y = max(dst_y - 1, 0); near_y <= min(dst_y + 1, target_height - 1); ++near_y)
        for (int near_x = max(dst_x - 1, 0); near_x <= min(dst_x + 1, target_width - 1); ++near_x) {
            const Rgb t = load_rgb(truth, near_y * target_width + near_x);
            const float sum = relative_error(exposure * c.r, exposure * t.r)
                              + relative_error(exposure * c.g, exposure * t.g)
                              + relative_error(exposure * c.b, exposure * t.b);
            smallest = lesser(smallest, sum);
        }
    focus_truth[dst] = smallest > 3.0f * FOCUS_SMAPE && !is_dynamic[dst];
}
