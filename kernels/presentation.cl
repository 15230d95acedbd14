/* The display part of a rendered frame (paper: 'Adaptive rendering window'; its runtime table's 'Misc').
   A mapping is (scale x, scale y, offset x, offset y) between pixel positions of two images of one pose. */

#include "frame.h"
#include "rgb.h"

#define PRESENTED_ROWS 16  /* rows per work-item: rows filtered horizontally serve several of them */

/* Cubic weights (Catmull-Rom) of the four taps around t in [0, 1). */
INLINE float4 cubic_weights(const float t) {
    const float t2 = t * t, t3 = t2 * t;
    return (float4)(-0.5f * t + t2 - 0.5f * t3, 1.0f - 2.5f * t2 + 1.5f * t3, 0.5f * t + 2.0f * t2 - 1.5f * t3,
                    0.5f * t3 - 0.5f * t2);
}

INLINE float cubic_1d(const float4 w, const float a, const float b, const float c, const float d) {
    return lesser(greater(w.x * a + w.y * b + w.z * c + w.w * d, lesser(b, c)), greater(b, c));
}

INLINE Rgb cubic_rgb(const float4 w, const Rgb a, const Rgb b, const Rgb c, const Rgb d) {
    const Rgb made = {cubic_1d(w, a.r, b.r, c.r, d.r), cubic_1d(w, a.g, b.g, c.g, d.g),
                      cubic_1d(w, a.b, b.b, c.b, d.b)};
    return made;
}

INLINE float2 mapped(const float2 px, const float4 mapping) { return px * mapping.xy + mapping.zw; }

/* Color, resampled: cubic along rows, then along columns, each clamped to the two taps between. Beyond the image its
   border is repeated. */
__kernel void present_color(__constant Frame *restrict frame, __global const uint2 *color, __global half *out_color) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int source_width = frame->source_width, source_height = frame->source_height;
    const float4 to_render = frame->to_render;
    const int dst_x = get_global_id(0), first = get_global_id(1) * PRESENTED_ROWS;
    if (dst_x >= target_width) return;
    const float px_render = ((float)dst_x + 0.5f) * to_render.x + to_render.z;
    const float left = floor(px_render - 0.5f);
    const float4 weights_x = cubic_weights(px_render - 0.5f - left);
    const int right = source_width - 1, x0 = (int)left - 1;
    const int4 tap =
        (int4)(clamp(x0, 0, right), clamp(x0 + 1, 0, right), clamp(x0 + 2, 0, right), clamp(x0 + 3, 0, right));

    Rgb row0 = {0.0f, 0.0f, 0.0f}, row1 = row0, row2 = row0, row3 = row0;
    int held = INT_MIN / 2;  /* the row of row0 */
    for (int dst_y = first; dst_y < min(first + PRESENTED_ROWS, target_height); ++dst_y) {
        const float py_render = ((float)dst_y + 0.5f) * to_render.y + to_render.w;
        const float top = floor(py_render - 0.5f);
        const int y0 = (int)top - 1;
        for (int k = clamp(held + 4 - y0, 0, 4); k < 4; ++k) {
            const int row = clamp(y0 + k, 0, source_height - 1) * source_width;
            row0 = row1;
            row1 = row2;
            row2 = row3;
            row3 = cubic_rgb(weights_x, load_rgb(color, row + tap.x), load_rgb(color, row + tap.y),
                             load_rgb(color, row + tap.z), load_rgb(color, row + tap.w));
        }
        held = y0;
        const Rgb c = cubic_rgb(cubic_weights(py_render - 0.5f - top), row0, row1, row2, row3);
        store_color((float3)(c.r, c.g, c.b), out_color, dst_y * target_width + dst_x);
    }
}

/* Depth and motion of the nearest rendered pixel; motion from its own position on the display to where that surface
   was on the previous display. */
__kernel void present_geometry(__constant Frame *restrict frame, __global const float *depth,
                               __global const float2 *motion, __global float *out_depth, __global float2 *out_motion) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1), dst = dst_y * frame->target_width + dst_x;
    if (dst_x >= frame->target_width || dst_y >= frame->target_height) return;
    const float2 px_render = mapped(pixel_center(dst_x, dst_y), frame->to_render);
    const int src_x = clamp((int)floor(px_render.x), 0, frame->source_width - 1);
    const int src_y = clamp((int)floor(px_render.y), 0, frame->source_height - 1);
    const int src = src_y * frame->source_width + src_x;
    const float2 center = pixel_center(src_x, src_y);
    out_depth[dst] = depth[src];
    out_motion[dst] = mapped(center + motion[src], frame->to_previous_display) - mapped(center, frame->to_display);
}
