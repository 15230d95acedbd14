/* Inputs of the shading correction network (paper: 'Shading Correction Network'): the previous rendered frame,
   warped, at full size for display. */

#include "frame.h"
#include "warped_previous.h"

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
