/* Story of a fragment of the rendered frame: its prediction. */

#define STORY

/* How many of P_1 ... are used; whether the camera carries its mover, and whether that spins; how much of the mover's
   acceleration counts, 0 to 1. */
enum { KNOWN, CARRIED, SPINS, TRUST, TOLD_OF_PREDICTION };

#include "../prediction.cl"

/* Tells of the dynamic fragment at pixel `src`; the numbers come as zeros. */
__kernel void tell_prediction(__constant Frame *restrict frame, const int src, __global const float *depth,
                              __global const float2 *motion, __global const uchar *dynamic_mask,
                              __global const float *met_depth, __global const float4 *history,
                              __global const float4 *velocity, __global const uint2 *acceleration,
                              __global const uint2 *bend, __global const uint2 *view_velocity, __global float *told) {
    const Tracked fragments = {depth,    motion,       dynamic_mask, met_depth,     history,
                               velocity, acceleration, bend,         view_velocity, told};
    const Frame given = *frame;
    predicted_position(src % frame->source_width, src / frame->source_width, &given, fragments);
}
