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

/* Weights of the columns with which those of all 4x4 taps but the corners, which weigh little, add up to 1. */
INLINE float4 without_corners(const float4 wx, const float4 wy) {
    return wx * divide(1.0f, 1.0f - (wx.x + wx.w) * (wy.x + wy.w));
}

INLINE void wide_without_corners(Floats *wx, const Floats *wy) {
    const Floats scale = wide_divide((Floats)(1.0f), 1.0f - (wx[0] + wx[3]) * (wy[0] + wy[3]));
    for (int k = 0; k < 4; ++k) wx[k] *= scale;
}

/* Cubic interpolation of 4x4 taps in four rows, but for the corners, clamped to the four inner ones. Of finite numbers.
   The first and the last row begin at the second tap. */
INLINE float4 cubic_of_rows(const float8 a, const float16 b, const float16 c, const float8 d, const float4 wx,
                            const float4 wy) {
    const float16 columns = wy.y * b + wy.z * c;
    const float8 inner = columns.s456789ab + (wy.x * a + wy.w * d);
    const float4 sum = wx.x * columns.s0123 + wx.y * inner.lo + wx.z * inner.hi + wx.w * columns.scdef;
    const float8 least = b.s456789ab < c.s456789ab ? b.s456789ab : c.s456789ab,
                 most = b.s456789ab < c.s456789ab ? c.s456789ab : b.s456789ab;
    const float4 low = least.lo < least.hi ? least.lo : least.hi, high = most.lo < most.hi ? most.hi : most.lo;
    const float4 raised = sum < low ? low : sum;
    return high < raised ? high : raised;
}

/* The same of the taps from index `first` on. */
INLINE float3 cubic(const int first, const float4 wx, const float4 wy, const int width, __global const half *image) {
    return cubic_of_rows(load_two_texels(first + 1, image), load_four_texels(first + width, image),
                         load_four_texels(first + 2 * width, image), load_two_texels(first + 3 * width + 1, image), wx,
                         wy)
        .xyz;
}

#if LANES == 8

/* Weights of four pixels, each for the four channels of its texel. */
#define SPREAD(w) ((w).s0000111122223333)
#define WITHOUT_ALPHA(c) ((float16)((c).s012, 0.0f, (c).s456, 0.0f, (c).s89a, 0.0f, (c).scde, 0.0f))

/* cubic of four pixels in a row whose taps lie in a row, from index `first` on. */
INLINE float16 cubic_of_run(const int first, const float4 *wx, const float4 *wy, const int width,
                            __global const half *image) {
    float16 total, low, high;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        __global const half *p = image + 4 * (first + tx);
        const float16 b = vload_half16(0, p + 4 * width), c = vload_half16(0, p + 8 * width);
        float16 column = SPREAD(wy[1]) * b + SPREAD(wy[2]) * c;
        if (tx == 1 || tx == 2) {
            column += SPREAD(wy[0]) * vload_half16(0, p) + SPREAD(wy[3]) * vload_half16(0, p + 12 * width);
            const float16 lower = b < c ? b : c, higher = b < c ? c : b;
            low = tx == 1 ? lower : low < lower ? low : lower;
            high = tx == 1 ? higher : high < higher ? higher : high;
        }
        total = tx == 0 ? SPREAD(wx[0]) * column : total + SPREAD(wx[tx]) * column;
    }
    const float16 raised = total < low ? low : total;
    return high < raised ? high : raised;
}

#endif
