/* Fine detail of the new frame: what resampling between pixels has softened is made sharper, along each axis by how
   far from pixels it was. So colors that alternate with rendered frames are about as sharp as those. */

#include "frame.h"
#include "color_code.h"

#define SHARPER_BETWEEN 0.5f /* midway: by so much of the difference from the mean of both neighbors */

/* Whole pixels keep their bits; the others stay within the range of the 3x3 colors around. */
__kernel void sharpen(__constant Frame *restrict frame, __global const half *color, __global const float2 *motion,
                      __global half *out_color) {
    const int width = frame->target_width, height = frame->target_height;
    const int x = get_global_id(0), y = get_global_id(1), dst = y * width + x;
    if (x >= width || y >= height) return;
    const float2 px = pixel_center(x, y) + motion[dst] - 0.5f, part = px - floor(px);
    const float2 between = SHARPER_BETWEEN * (1.0f - fabs(2.0f * part - 1.0f));
    if (!(between.x > 0.0f || between.y > 0.0f)) {
        store_color(load_color(color, dst), out_color, dst);
        return;
    }
    const float3 own = load_code(color, dst, frame->code_offset);
    float3 low = own, high = own, across = (float3)(0.0f), down = (float3)(0.0f);
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1;
        const int i = clamp(y + dy, 0, height - 1) * width + clamp(x + dx, 0, width - 1);
        const float3 beside = load_code(color, i, frame->code_offset);
        low = fmin(low, beside);
        high = fmax(high, beside);
        if (dy == 0 && dx != 0) across += own - beside;
        if (dx == 0 && dy != 0) down += own - beside;
    }
    const float3 sharper = own + 0.5f * (between.x * across + between.y * down);
    store_code(clamp(sharper, low, high), out_color, dst, frame->code_offset);
}
