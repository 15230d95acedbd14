/* Story of a hole: which pixels beside it the far side takes. */

#define STORY

/* What is told of each direction: whether it `meets` a pixel beside the hole, and is TAKEN; that pixel and the inverse
   depth that counts; whether a static surface can be there; 1 + the pixel that was met before, past which it looks; and
   whether what the rendered frame shows beyond the edge of the surface that ENDS there counts. */
enum { MEETS, TAKEN, AT, INVERSE, CAN_BE_THERE, PAST, ENDS, TOLD_OF_SIDE };

#include "../holes.cl"

/* Tells of the pixel `hole`, TOLD_OF_SIDE numbers of each of DIRECTIONS, which come as zeros; then whether surfaces out
   of the rendered image fill it. For one work-group. */
WALK __kernel void tell_holes(__constant Frame *restrict frame, const int hole, __global const uchar *filled_by,
                              __global const half *codes, __global const float *source_depth,
                              __global const uchar *source_is_dynamic, __global const uchar *is_dynamic,
                              __global half *color, __global float *depth, __global float2 *motion,
                              __global float *told) {
    __local Side sides[TEAMS][DIRECTIONS];
    const Images images = {filled_by, codes, source_depth, source_is_dynamic, is_dynamic, color, depth, motion, told};
    const int team = get_local_id(0) / TEAM;
    look_around(team ? NO_ENTRY : (uint)hole, frame, images, sides[team]);
    if (get_local_id(0)) return;
    bool is_out = false;
    const int taken = meets_any(sides[0]) ? continued_directions(sides[0], &is_out) : 0;
    for (int k = 0; k < DIRECTIONS; ++k) {
        __global float *side = told + k * TOLD_OF_SIDE;
        side[MEETS] = sides[0][k].meets;
        side[TAKEN] = has(taken, k);
        side[AT] = sides[0][k].px;
        side[INVERSE] = sides[0][k].inverse;
        side[CAN_BE_THERE] = sides[0][k].can_be_there;
    }
    told[DIRECTIONS * TOLD_OF_SIDE] = is_out;
}
