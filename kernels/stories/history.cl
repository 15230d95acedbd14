/* Story of a fragment of the rendered frame: the static test. */

enum { STATIC_MOTION_X, STATIC_MOTION_Y, STATIC_DEPTH, RESIDUAL, THRESHOLD, MOVES, TOLD_OF_TEST };

#include "../history.cl"

/* Tells of pixel `src` the motion and the depth in the frame before that a static fragment would have, px, by how much
   its own motion differs, the threshold of that, and whether it moves. */
__kernel void tell_history(__constant Frame *restrict frame, const int src, __global const float *depth,
                           __global const float2 *motion, __global const float *threshold_squared,
                           __global const float *quantization_error, __global float *told) {
    const float2 px = pixel_center(src % frame->source_width, src / frame->source_width), mv = motion[src];
    const StaticTest test = static_test((Floats)(px.x), (Floats)(px.y), (Floats)(depth[src]), (Floats)(mv.x),
                                        (Floats)(mv.y), *threshold_squared, quantization_error, frame);
    const float off_x = float_of(&test.off_x, 0), off_y = float_of(&test.off_y, 0);
    told[STATIC_MOTION_X] = float_of(&test.px_static.x, 0) - px.x;
    told[STATIC_MOTION_Y] = float_of(&test.px_static.y, 0) - px.y;
    told[STATIC_DEPTH] = float_of(&test.px_static.z, 0);
    told[RESIDUAL] = sqrt(off_x * off_x + off_y * off_y);
    told[THRESHOLD] = sqrt(*threshold_squared);
    told[MOVES] = int_of(&test.moves, 0) != 0;
}
