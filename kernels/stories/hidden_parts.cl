/* Story of a hole: why hidden parts of movers do not fill it. */

#define STORY

/* What is told of each direction: the mover met, STEPS away (0: none), and why it has no part in the hole; the depth of
   the surface between that was looked at last; where in the rendered image the part was, the depth shown there and its
   own; the same of the frame before. */
enum { STEPS, REFUSED_BY, MOVER_Z, BETWEEN_Z, PLACE_X, PLACE_Y, SHOWN_Z, PART_Z, PREV_X, PREV_Y, PREV_Z, PART_PREV_Z };
#define TOLD_OF_MOVER 12
enum { NOT_REFUSED, SURFACE_BETWEEN, OUT_OF_FRAME, NOT_HIDDEN, SEEN_THROUGH };

#include "../hidden_parts.cl"

/* Tells of the pixel `hole`, TOLD_OF_MOVER numbers of each of DIRECTIONS; they come as zeros. */
__kernel void tell_hidden_parts(__constant Frame *restrict frame, const int hole, __global const float *source_depth,
                                __global const float2 *source_motion, __global const float *depth_prev,
                                __global const uchar *disoccluded, __global const uchar *is_dynamic,
                                __global float *depth, __global float2 *motion, __global float *told) {
    Movers images = {.source_depth = source_depth, .depth_prev = depth_prev, .source_motion = source_motion};
    images.disoccluded = disoccluded;
    images.is_dynamic = is_dynamic;
    images.depth = depth;
    images.motion = motion;
    for (int k = 0; k < DIRECTIONS; ++k) {
        images.told = told + k * TOLD_OF_MOVER;
        steps_to_mover(hole % frame->target_width, hole / frame->target_width, direction(k), frame, images);
    }
}
