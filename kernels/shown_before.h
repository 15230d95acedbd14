/* Colors of static points in the frame before (background.cl, holes.cl). */

#include "frame.h"
#include "color_code.h"

#define SAME_LEVEL 0.02f /* relative depth within which two fragments may be of the same surface */

/* The frame before. `state`, if not 0: only pixels that are SHOWN count, which hold their own surface's color only. */
typedef struct {
    __global const half *color;
    __global const float *depth;
    __global const uchar *state;
} Before;

/* Code of the color of a static point in the frame before; false where that did not show its surface all around. */
INLINE bool shown_before(const float2 center, const float z, __constant Frame *frame, const Before before,
                         float3 *code) {
    const int width = frame->source_width, height = frame->source_height;
    const float3 px_prev = reproject(center, z, frame->target_to_previous);
    if (!(px_prev.z > 0.0f && px_prev.x >= 0.5f && px_prev.y >= 0.5f && px_prev.x < (float)width - 0.5f
          && px_prev.y < (float)height - 0.5f)
        || (before.state && !(before.state[(int)px_prev.y * width + (int)px_prev.x] == SHOWN)))
        return false;
    const int x0 = (int)(px_prev.x - 0.5f), y0 = (int)(px_prev.y - 0.5f);
    const float u = px_prev.x - 0.5f - (float)x0, v = px_prev.y - 0.5f - (float)y0;
    float3 sum = (float3)(0.0f);
    for (int tap = 0; tap < 4; ++tap) {
        const int i = (y0 + (tap >> 1)) * width + x0 + (tap & 1);
        if (!is_same_surface(before.depth[i], px_prev.z, 2.0f * SAME_LEVEL * px_prev.z)) return false;
        sum += bilinear_weight(tap, u, v) * load_code(before.color, i, frame->code_offset);
    }
    *code = sum;
    return true;
}
