/* The acceleration of movers on its own, where no background is completed (background.cl). */

#include "acceleration.h"

/* One work-item per cell. */
SPARSE __kernel void track_acceleration(__constant Frame *restrict frame, __global const float *depth,
                                        __global const float2 *motion, __global const uchar *dynamic_mask,
                                        __global const float *met_depth, __global const float4 *velocity_prev,
                                        __global const uint2 *acceleration_prev, __global const uint2 *bend_prev,
                                        __global const uint2 *view_velocity_prev, __global float4 *velocity,
                                        __global uint2 *acceleration, __global uint2 *bend,
                                        __global uint2 *view_velocity) {
    const Tracked fragments = {depth, motion, dynamic_mask, met_depth};
    const Grid before = {velocity_prev, acceleration_prev, bend_prev, view_velocity_prev};
    const Cells to = {velocity, acceleration, bend, view_velocity};
    const int width = (frame->source_width + MOVER_CELL - 1) / MOVER_CELL;
    if ((int)get_global_id(0) < width)
        track_cell((int)(get_global_id(1) * width + get_global_id(0)), frame, fragments, before, to);
}
