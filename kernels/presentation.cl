/* The display part of a rendered frame (paper: 'Adaptive rendering window'; its runtime table's 'Misc').
   A mapping is (scale x, scale y, offset x, offset y) between pixel positions of two images of one pose. */

#include "common.h"
#include "cubic.h"

inline float2 mapped(const float2 px, const float4 mapping) { return px * mapping.xy + mapping.zw; }

/* As `cubic`, beyond the image too: its border goes on. */
inline float3 cubic_at_border(const int x0, const int y0, const float u, const float v, const int width, const int height,
                              __global const half *color) {
    const float4 wx4 = cubic_weights(u), wy4 = cubic_weights(v);
    const float wx[4] = {wx4.x, wx4.y, wx4.z, wx4.w}, wy[4] = {wy4.x, wy4.y, wy4.z, wy4.w};
    float3 sum = (float3)(0.0f), low = (float3)(INFINITY), high = (float3)(-INFINITY);
    for (int ty = 0; ty < 4; ++ty) {
        float3 row = (float3)(0.0f);
        for (int tx = 0; tx < 4; ++tx) {
            const int x = clamp(x0 + tx, 0, width - 1), y = clamp(y0 + ty, 0, height - 1);
            const float3 c = load_color(color, y * width + x);
            row += wx[tx] * c;
            if (tx == 0 || tx == 3 || ty == 0 || ty == 3) continue;
            low = fmin(low, c);
            high = fmax(high, c);
        }
        sum += wy[ty] * row;
    }
    return clamp(sum, low, high);
}

/* Colour is resampled; depth and motion are those of the nearest rendered pixel, motion from its own position on the display
   to where that surface was on the previous display. */
__kernel void present(const int width, const int height, const int source_width, const int source_height,
                      const float4 to_render, const float4 to_display, const float4 to_previous_display,
                      __global const half *color, __global const float *depth, __global const float2 *motion,
                      __global half *out_color, __global float *out_depth, __global float2 *out_motion) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height) return;
    const int i = y * width + x;
    const float2 px_render = mapped(pixel_centre(x, y), to_render);
    const float2 corner = floor(px_render - 0.5f);
    const float2 weight = px_render - 0.5f - corner;
    const int x0 = (int)corner.x - 1, y0 = (int)corner.y - 1;
    const bool within = x0 >= 0 && y0 >= 0 && x0 + 3 < source_width && y0 + 3 < source_height;
    float3 c = (float3)(NAN);
    if (within) c = cubic(x0, y0, weight.x, weight.y, source_width, false, color);
    if (isfinite(c.x) && isfinite(c.y) && isfinite(c.z)) {
        store_color(c, out_color, i);
    } else {
        store_color(cubic_at_border(x0, y0, weight.x, weight.y, source_width, source_height, color), out_color, i);
    }

    const int sx = clamp((int)floor(px_render.x), 0, source_width - 1);
    const int sy = clamp((int)floor(px_render.y), 0, source_height - 1);
    const int s = sy * source_width + sx;
    const float2 centre = pixel_centre(sx, sy);
    out_depth[i] = depth[s];
    out_motion[i] = mapped(centre + motion[s], to_previous_display) - mapped(centre, to_display);
}
