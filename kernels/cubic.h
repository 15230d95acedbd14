/* Cubic (Catmull-Rom) interpolation of half images. */

#include "rgb.h"
#include "simd.h"

/* Catmull-Rom weights of the four taps around t in [0, 1). */
inline float4 cubic_weights(const float t) {
    const float t2 = t * t, t3 = t2 * t;
    return (float4)(-0.5f * t + t2 - 0.5f * t3, 1.0f - 2.5f * t2 + 1.5f * t3, 0.5f * t + 2.0f * t2 - 1.5f * t3,
                    0.5f * t3 - 0.5f * t2);
}

/* The same of LANES numbers, by tap. */
inline void wide_cubic_weights(const Floats t, Floats *weights) {
    const Floats t2 = t * t, t3 = t2 * t;
    weights[0] = -0.5f * t + t2 - 0.5f * t3;
    weights[1] = 1.0f - 2.5f * t2 + 1.5f * t3;
    weights[2] = 0.5f * t + 2.0f * t2 - 1.5f * t3;
    weights[3] = 0.5f * t3 - 0.5f * t2;
}

/* Cubic interpolation of the 4x4 taps from (x0, y0) on, which lie in the image, clamped to the four inner ones. */
inline float3 cubic(const int x0, const int y0, const float u, const float v, const int width,
                    __global const uint2 *color) {
    const float4 wx = cubic_weights(u), wy4 = cubic_weights(v);
    const float wy[4] = {wy4.x, wy4.y, wy4.z, wy4.w};
    Rgb sum = {0.0f, 0.0f, 0.0f}, low = {INFINITY, INFINITY, INFINITY}, high = {-INFINITY, -INFINITY, -INFINITY};
#pragma unroll
    for (int ty = 0; ty < 4; ++ty) {
        const int i = (y0 + ty) * width + x0;
        const Rgb a = load_rgb(color, i), b = load_rgb(color, i + 1), c = load_rgb(color, i + 2), d = load_rgb(color,
                                                                                                               i + 3);
        sum.r += wy[ty] * (wx.x * a.r + wx.y * b.r + wx.z * c.r + wx.w * d.r);
        sum.g += wy[ty] * (wx.x * a.g + wx.y * b.g + wx.z * c.g + wx.w * d.g);
        sum.b += wy[ty] * (wx.x * a.b + wx.y * b.b + wx.z * c.b + wx.w * d.b);
        if (ty == 0 || ty == 3) continue;
        low.r = lesser(low.r, lesser(b.r, c.r));
        low.g = lesser(low.g, lesser(b.g, c.g));
        low.b = lesser(low.b, lesser(b.b, c.b));
        high.r = greater(high.r, greater(b.r, c.r));
        high.g = greater(high.g, greater(b.g, c.g));
        high.b = greater(high.b, greater(b.b, c.b));
    }
    return (float3)(lesser(greater(sum.r, low.r), high.r), lesser(greater(sum.g, low.g), high.g), lesser(greater(sum.b, low.b),
                                                                                                high.b));
}

/* The same of 4x4 taps in whole rows of half x4, and `sum`, which is not clamped. Of finite numbers. */
inline float4 cubic_of_rows(const float16 a, const float16 b, const float16 c, const float16 d, const float4 wx, const float4 wy,
                            float4 *sum) {
    const float16 columns = wy.x * a + wy.y * b + wy.z * c + wy.w * d;
    *sum = wx.x * columns.s0123 + wx.y * columns.s4567 + wx.z * columns.s89ab + wx.w * columns.scdef;
    const float16 low_columns = b < c ? b : c, high_columns = b < c ? c : b;
    const float4 low = low_columns.s4567 < low_columns.s89ab ? low_columns.s4567 : low_columns.s89ab;
    const float4 high = high_columns.s4567 < high_columns.s89ab ? high_columns.s89ab : high_columns.s4567;
    const float4 raised = *sum < low ? low : *sum;
    return high < raised ? high : raised;
}

/* Of the 4x4 taps from index `first` on; false where a tap is no finite number. */
inline bool cubic_of_finite(const int first, const float4 wx, const float4 wy, const int width, __global const half *color,
                            float4 *rgb) {
    __global const half *p = color + 4 * first;
    float4 sum;
    *rgb = cubic_of_rows(vload_half16(0, p), vload_half16(0, p + 4 * width), vload_half16(0, p + 8 * width),
                         vload_half16(0, p + 12 * width), wx, wy, &sum);
    return fabs(sum.x) <= COLOR_MAX && fabs(sum.y) <= COLOR_MAX && fabs(sum.z) <= COLOR_MAX;
}

#if LANES == 8

/* Weights of four pixels, each for the four channels of its texel. */
#define SPREAD(w) ((w).s0000111122223333)
#define WITHOUT_ALPHA(c) ((float16)((c).s012, 0.0f, (c).s456, 0.0f, (c).s89a, 0.0f, (c).scde, 0.0f))

/* cubic_of_rows of four pixels in a row whose taps lie in a row, from index `first` on. */
inline float16 cubic_of_run(const int first, const float4 *wx, const float4 *wy, const int width, __global const half *color,
                            float16 *sum) {
    float16 total, low, high;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        __global const half *p = color + 4 * (first + tx);
        const float16 a = vload_half16(0, p), b = vload_half16(0, p + 4 * width), c = vload_half16(0, p + 8 * width),
                      d = vload_half16(0, p + 12 * width);
        const float16 column = SPREAD(wy[0]) * a + SPREAD(wy[1]) * b + SPREAD(wy[2]) * c + SPREAD(wy[3]) * d;
        total = tx == 0 ? SPREAD(wx[0]) * column : total + SPREAD(wx[tx]) * column;
        if (tx == 0 || tx == 3) continue;
        const float16 lower = b < c ? b : c, higher = b < c ? c : b;
        low = tx == 1 ? lower : low < lower ? low : lower;
        high = tx == 1 ? higher : high < higher ? higher : high;
    }
    *sum = total;
    const float16 raised = total < low ? low : total;
    return high < raised ? high : raised;
}

/* Their colours; false where a tap is no finite number. */
inline bool cubic_of_four(const int first, const float4 *wx, const float4 *wy, const int width, __global const half *color,
                          const int dst, __global half *out_color) {
    float16 sum;
    const float16 made = cubic_of_run(first, wx, wy, width, color, &sum);
    vstore_half16_rte(WITHOUT_ALPHA(made), 0, out_color + 4 * dst);
    return all(fabs(WITHOUT_ALPHA(sum)) <= COLOR_MAX);
}

#endif
