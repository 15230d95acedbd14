/* What lies around a hole in eight directions, and the farthest of it (projection.cl, holes.cl). */

#include "frame.h"
#include "color_code.h"
#include "directional_search.h"

/* What set the threshold: docs/deviations.md, "Holes continue surfaces that can be there". */
#define FAR_SIDE 1.3f /* inverse depths up to this times another are of the same surface, or of a farther one */

INLINE float inverse_of(const float z) { return isinf(z) ? 0.0f : divide(1.0f, z); }

/* What a direction from a hole meets: whether it `meets` a pixel beside the hole, the pixel, its code, inverse depth
   and 1 / distance (1/px); whether it is a mover's; continued to the hole, whether it lies outside of the rendered
   image, and whether it can be there as a static surface. `support`: of surface_behind (holes.cl). */
typedef struct {
    bool meets, is_of_mover, is_outside, can_be_there;
    int px;
    float closeness, inverse, code_x, code_y, code_z, support;
} Side;

/* Lets a direction from the hole `dst` meet a pixel, t steps of d away ... */
INLINE void meet(Side *side, const int dst, const int t, const int2 d, __constant Frame *frame) {
    side->px = dst + t * (d.y * frame->target_width + d.x);
    side->closeness = divide(1.0f, (float)t * step_length(d));
}

/* ... which shows this (code, depth). */
INLINE void show(Side *side, const float4 shown) {
    side->inverse = inverse_of(shown.w);
    side->code_x = shown.x;
    side->code_y = shown.y;
    side->code_z = shown.z;
}

/* Looks in direction k from a hole, up to `reach` px away, for a pixel that `mask` does not call a `hole`. The caller
   says what that shows. */
INLINE Side look(const int dst_x, const int dst_y, const int k, const int reach, __constant Frame *frame,
                 __global const uchar *mask, const uchar hole) {
    const int width = frame->target_width, dst = dst_y * width + dst_x;
    const int2 d = direction(k);
    const int offset = d.y * width + d.x;
    const int t =
        first_other(dst, offset, steps_within(reach, d, dst_x, dst_y, width, frame->target_height), mask, hole);
    Side side = {t != 0, false, false, false, dst, 0.0f, INFINITY, 0.0f, 0.0f, 0.0f, 0.0f};
    if (t != 0) meet(&side, dst, t, d, frame);
    return side;
}

INLINE bool is_as_far(const float inverse, const float other) {
    return !(inverse > other * FAR_SIDE) && !(other > inverse * FAR_SIDE);
}

/* The directions that meet the far side, in bits. */
INLINE int far_side(__local const Side *sides) {
    float least = INFINITY;
    int far = 0;
    for (int k = 0; k < DIRECTIONS; ++k) least = fmin(least, sides[k].inverse);
    for (int k = 0; k < DIRECTIONS; ++k) far |= (sides[k].meets && !(sides[k].inverse > least * FAR_SIDE)) << k;
    return far;
}

/* Mean (color, inverse depth) of the pixels in some directions, weighted by their closeness, or by its `square`. */
INLINE float4 weighted_mean(__local const Side *sides, const int directions, const bool square,
                            const float code_offset) {
    float4 sum = (float4)(0.0f);
    float weight_sum = 0.0f;
    for (int k = 0; k < DIRECTIONS; ++k) {
        if (!has(directions, k)) continue;
        const Side s = sides[k];
        const float weight = square ? s.closeness * s.closeness : s.closeness;
        sum += weight * (float4)(s.code_x, s.code_y, s.code_z, s.inverse);
        weight_sum += weight;
    }
    return (float4)(decode_color(mean_of(sum.xyz, weight_sum), code_offset), divide(sum.w, weight_sum));
}
