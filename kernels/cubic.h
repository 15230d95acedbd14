/* Cubic (Catmull-Rom) interpolation of half images. */

#include "rgb.h"
#include "simd.h"

/* Catmull-Rom weights of the four taps around t in [0, 1). */
INLINE float4 cubic_weights(const float t) {
    const float t2 = t * t, t3 = t2 * t;
    return (float4)(-0.5f * t + t2 - 0.5f * t3, 1.0f - 2.5f * t2 + 1.5f * t3, 0.5f * t + 2.0f * t2 - 1.5f * t3,
                    0.5f * t3 - 0.5f * t2);
}

/* The cubic weights of LANES numbers, by tap. */
INLINE void wide_cubic_weights(const Floats t, Floats *weights) {
    const Floats t2 = t * t, t3 = t2 * t;
    weights[0] = -0.5f * t + t2 - 0.5f * t3;
    weights[1] = 1.0f - 2.5f * t2 + 1.5f * t3;
    weights[2] = 0.5f * t + 2.0f * t2 - 1.5f * t3;
    weights[3] = 0.5f * t3 - 0.5f * t2;
}

/* Cubic interpolation of the 4x4 taps from index `first` on, clamped to the four inner ones. Of finite numbers. */
INLINE float3 cubic(const int first, const float4 wx, const float4 wy, const int width, __global const half *image) {
    __global const half *p = image + 4 * first;
    const float16 a = vload_half16(0, p), b = vload_half16(0, p + 4 * width), c = vload_half16(0, p + 8 * width),
                  d = vload_half16(0, p + 12 * width);
    const float16 columns = wy.x * a + wy.y * b + wy.z * c + wy.w * d;
    const float4 sum = wx.x * columns.s0123 + wx.y * columns.s4567 + wx.z * columns.s89ab + wx.w * columns.scdef;
    const float16 low_columns = b < c ? b : c, high_columns = b < c ? c : b;
    const float4 low = low_columns.s4567 < low_columns.s89ab ? low_columns.s4567 : low_columns.s89ab;
    const float4 high = high_columns.s4567 < high_columns.s89ab ? high_columns.s89ab : high_columns.s4567;
    const float4 raised = sum < low ? low : sum;
    return (high < raised ? high : raised).xyz;
}

#if LANES == 8

/* Weights of four pixels, each for the four channels of its texel. */
#define SPREAD(w) ((w).s0000111122223333)
#define WITHOUT_ALPHA(c) ((float16)((c).s012, 0.0f, (c).s456, 0.0f, (c).s89a, 0.0f, (c).scde, 0.0f))

/* Seven texels of a row: those from each of the first four on, four at a time. */
INLINE void load_taps(__global const half *p, float16 *taps) {
    const float16 a = vload_half16(0, p), b = vload_half16(0, p + 12);
    taps[0] = a;
    taps[1] = (float16)(a.s4567, a.s89ab, a.scdef, b.s4567);
    taps[2] = (float16)(a.s89ab, a.scdef, b.s4567, b.s89ab);
    taps[3] = b;
}

/* cubic of four pixels in a row whose taps lie in a row, from index `first` on. */
INLINE float16 cubic_of_run(const int first, const float4 *wx, const float4 *wy, const int width,
                            __global const half *image) {
    __global const half *p = image + 4 * first;
    float16 total, low, high, a[4], b[4], c[4], d[4];
    load_taps(p, a);
    load_taps(p + 4 * width, b);
    load_taps(p + 8 * width, c);
    load_taps(p + 12 * width, d);
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        const float16 column =
            SPREAD(wy[0]) * a[tx] + SPREAD(wy[1]) * b[tx] + SPREAD(wy[2]) * c[tx] + SPREAD(wy[3]) * d[tx];
        total = tx == 0 ? SPREAD(wx[0]) * column : total + SPREAD(wx[tx]) * column;
        if (tx == 0 || tx == 3) continue;
        const float16 lower = b[tx] < c[tx] ? b[tx] : c[tx], higher = b[tx] < c[tx] ? c[tx] : b[tx];
        low = tx == 1 ? lower : low < lower ? low : lower;
        high = tx == 1 ? higher : high < higher ? higher : high;
    }
    const float16 raised = total < low ? low : total;
    return high < raised ? high : raised;
}

#endif
