/* Cubic (Catmull-Rom) interpolation of half images. */

#include "rgb.h"
#include "simd.h"

#define CATMULL_ROM 0.5f /* slope */

/* Weights of cubic convolution (Keys) of the four taps around t in [0, 1), with these slopes at the taps: with
   CATMULL_ROM it is Catmull-Rom, with more it is sharper. */
INLINE float4 cubic_weights(const float t, const float slope) {
    const float t2 = t * t, t3 = t2 * t;
    return (float4)(slope * (2.0f * t2 - t - t3), 1.0f + (slope - 3.0f) * t2 + (2.0f - slope) * t3,
                    slope * t + (3.0f - 2.0f * slope) * t2 + (slope - 2.0f) * t3, slope * (t3 - t2));
}

/* The cubic weights of LANES numbers, by tap. */
INLINE void wide_cubic_weights(const Floats t, const float slope, Floats *weights) {
    const Floats t2 = t * t, t3 = t2 * t;
    weights[0] = slope * (2.0f * t2 - t - t3);
    weights[1] = 1.0f + (slope - 3.0f) * t2 + (2.0f - slope) * t3;
    weights[2] = slope * t + (3.0f - 2.0f * slope) * t2 + (slope - 2.0f) * t3;
    weights[3] = slope * (t3 - t2);
}

/* Weights of the columns with which those of all 4x4 taps but the corners, which weigh little, add up to 1. */
INLINE float4 without_corners(const float4 wx, const float4 wy) {
    return wx * divide(1.0f, 1.0f - (wx.x + wx.w) * (wy.x + wy.w));
}

INLINE void wide_without_corners(Floats *wx, const Floats *wy) {
    const Floats scale = wide_divide((Floats)(1.0f), 1.0f - (wx[0] + wx[3]) * (wy[0] + wy[3]));
    for (int k = 0; k < 4; ++k) wx[k] *= scale;
}

#define NOT_STEEPER 0.0f /* for `per_range`: interpolation alone */

/* A color that is steepened moves away from the middle of its taps, by `amount` of its distance, in proportion to their
   range, least to most, up to 1 / per_range. */
#define DEFINE_STEEPENED(F, name)                                                                                      \
    INLINE F name(const F color, const F amount, const float per_range, const F least, const F most) {                 \
        const F range = (most - least) * per_range, part = range < 1.0f ? range : (F)(1.0f);                           \
        return color + amount * part * (color - 0.5f * (least + most));                                                \
    }

DEFINE_STEEPENED(float4, steepened)

/* Cubic interpolation of 4x4 taps in four rows, but for the corners, steepened, and clamped to the four inner ones. Of
   finite numbers. The first and the last row begin at the second tap. */
INLINE float4 cubic_of_rows(const float8 a, const float16 b, const float16 c, const float8 d, const float4 wx,
                            const float4 wy, const float steeper, const float per_range) {
    const float16 columns = wy.y * b + wy.z * c;
    const float8 inner = columns.s456789ab + (wy.x * a + wy.w * d);
    float4 sum = wx.x * columns.s0123 + wx.y * inner.lo + wx.z * inner.hi + wx.w * columns.scdef;
    const float16 lower = b < c ? b : c, higher = b < c ? c : b;
    const float8 least = lower.s456789ab, most = higher.s456789ab;
    const float4 low = least.lo < least.hi ? least.lo : least.hi, high = most.lo < most.hi ? most.hi : most.lo;
    if (per_range != NOT_STEEPER) {
        const float8 ends_low = lower.s0123cdef, ends_high = higher.s0123cdef;
        const float8 rows_low = a < d ? a : d, rows_high = a < d ? d : a;
        const float8 outer_low = rows_low < ends_low ? rows_low : ends_low,
                     outer_high = rows_high < ends_high ? ends_high : rows_high;
        const float4 all_low = outer_low.lo < outer_low.hi ? outer_low.lo : outer_low.hi,
                     all_high = outer_high.lo < outer_high.hi ? outer_high.hi : outer_high.lo;
        sum = steepened(sum, (float4)(steeper), per_range, all_low < low ? all_low : low,
                        all_high < high ? high : all_high);
    }
    const float4 raised = sum < low ? low : sum;
    return high < raised ? high : raised;
}

/* The same of the taps from index `first` on. */
INLINE float3 cubic(const int first, const float4 wx, const float4 wy, const int width, __global const half *image,
                    const float steeper, const float per_range) {
    return cubic_of_rows(load_two_texels(first + 1, image), load_four_texels(first + width, image),
                         load_four_texels(first + 2 * width, image), load_two_texels(first + 3 * width + 1, image), wx,
                         wy, steeper, per_range)
        .xyz;
}

#if LANES == 8

DEFINE_STEEPENED(float16, steepened_four)

/* Weights of four pixels, each for the four channels of its texel. */
#define SPREAD(w) ((w).s0000111122223333)
#define WITHOUT_ALPHA(c) ((float16)((c).s012, 0.0f, (c).s456, 0.0f, (c).s89a, 0.0f, (c).scde, 0.0f))

/* cubic of four pixels in a row whose taps lie in a row, from index `first` on. */
INLINE float16 cubic_of_run(const int first, const float4 *wx, const float4 *wy, const int width,
                            __global const half *image, const float4 steeper, const float per_range) {
    float16 total, low, high, outer_low, outer_high;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        __global const half *p = image + 4 * (first + tx);
        const float16 b = vload_half16(0, p + 4 * width), c = vload_half16(0, p + 8 * width);
        const float16 lower = b < c ? b : c, higher = b < c ? c : b;
        float16 column = SPREAD(wy[1]) * b + SPREAD(wy[2]) * c, ends_low = lower, ends_high = higher;
        if (tx == 1 || tx == 2) {
            const float16 a = vload_half16(0, p), d = vload_half16(0, p + 12 * width);
            column += SPREAD(wy[0]) * a + SPREAD(wy[3]) * d;
            low = tx == 1 ? lower : low < lower ? low : lower;
            high = tx == 1 ? higher : high < higher ? higher : high;
            ends_low = a < d ? a : d;
            ends_high = a < d ? d : a;
        }
        outer_low = tx == 0 ? ends_low : outer_low < ends_low ? outer_low : ends_low;
        outer_high = tx == 0 ? ends_high : outer_high < ends_high ? ends_high : outer_high;
        total = tx == 0 ? SPREAD(wx[0]) * column : total + SPREAD(wx[tx]) * column;
    }
    if (per_range != NOT_STEEPER)
        total = steepened_four(total, SPREAD(steeper), per_range, outer_low < low ? outer_low : low,
                               outer_high < high ? high : outer_high);
    const float16 raised = total < low ? low : total;
    return high < raised ? high : raised;
}

#endif
