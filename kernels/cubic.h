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

/* Cubic interpolation of 4x4 taps but for the corners, for colors of type F, a column at a time: all of them at once
   take many registers. Of finite numbers. The result is steepened: it moves away from the middle of its taps, by
   `steeper` of its distance, in proportion to their range, up to 1 / per_range. Then it is clamped to the four inner
   taps. Of the first and the last column, only the taps b and c count. */
#define DEFINE_CUBIC(F, Sums, add_column, sums_up)                                                                     \
    typedef struct {                                                                                                   \
        F sum, low, high, outer_low, outer_high;                                                                       \
    } Sums;                                                                                                            \
    INLINE void add_column(const int tx, const F a, const F b, const F c, const F d, const F weight, const F *wy,      \
                           Sums *s) {                                                                                  \
        const F lower = b < c ? b : c, higher = b < c ? c : b;                                                         \
        F column = wy[1] * b + wy[2] * c, outer_low = lower, outer_high = higher;                                      \
        if (tx == 1 || tx == 2) {                                                                                      \
            column += wy[0] * a + wy[3] * d;                                                                           \
            s->low = tx == 1 ? lower : s->low < lower ? s->low : lower;                                                \
            s->high = tx == 1 ? higher : s->high < higher ? higher : s->high;                                          \
            outer_low = a < d ? a : d;                                                                                 \
            outer_high = a < d ? d : a;                                                                                \
        }                                                                                                              \
        s->outer_low = tx == 0 ? outer_low : s->outer_low < outer_low ? s->outer_low : outer_low;                      \
        s->outer_high = tx == 0 ? outer_high : s->outer_high < outer_high ? outer_high : s->outer_high;                \
        s->sum = tx == 0 ? weight * column : s->sum + weight * column;                                                 \
    }                                                                                                                  \
    INLINE F sums_up(const Sums s, const F steeper, const float per_range) {                                           \
        F sum = s.sum;                                                                                                 \
        if (per_range != NOT_STEEPER) {                                                                                \
            const F least = s.outer_low < s.low ? s.outer_low : s.low,                                                 \
                    most = s.outer_high < s.high ? s.high : s.outer_high;                                              \
            const F range = (most - least) * per_range, part = range < 1.0f ? range : (F)(1.0f);                       \
            sum += steeper * part * (sum - 0.5f * (least + most));                                                     \
        }                                                                                                              \
        const F raised = sum < s.low ? s.low : sum;                                                                    \
        return s.high < raised ? s.high : raised;                                                                      \
    }

DEFINE_CUBIC(float4, CubicSums, add_column, sums_up)

INLINE float component_of(const float4 w, const int k) { return k == 0 ? w.x : k == 1 ? w.y : k == 2 ? w.z : w.w; }

/* The same of the taps from index `first` on. */
INLINE float3 cubic(const int first, const float4 wx, const float4 wy, const int width, __global const half *image,
                    const float steeper, const float per_range) {
    const float4 rows[4] = {(float4)(wy.x), (float4)(wy.y), (float4)(wy.z), (float4)(wy.w)};
    CubicSums s;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        const float4 b = load_texel(first + width + tx, image), c = load_texel(first + 2 * width + tx, image);
        const bool inner = tx == 1 || tx == 2;
        const float4 a = inner ? load_texel(first + tx, image) : b,
                     d = inner ? load_texel(first + 3 * width + tx, image) : c;
        add_column(tx, a, b, c, d, (float4)(component_of(wx, tx)), rows, &s);
    }
    return sums_up(s, (float4)(steeper), per_range).xyz;
}

#if LANES == 8

DEFINE_CUBIC(float16, FourCubicSums, add_four_columns, sum_up_four)

/* Weights of four pixels, each for the four channels of its texel. */
#define SPREAD(w) ((w).s0000111122223333)
#define WITHOUT_ALPHA(c) ((float16)((c).s012, 0.0f, (c).s456, 0.0f, (c).s89a, 0.0f, (c).scde, 0.0f))

/* cubic of four pixels in a row whose taps lie in a row, from index `first` on. */
INLINE float16 cubic_of_run(const int first, const float4 *wx, const float4 *wy, const int width,
                            __global const half *image, const float4 steeper, const float per_range) {
    const float16 rows[4] = {SPREAD(wy[0]), SPREAD(wy[1]), SPREAD(wy[2]), SPREAD(wy[3])};
    FourCubicSums s;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        __global const half *p = image + 4 * (first + tx);
        const float16 b = vload_half16(0, p + 4 * width), c = vload_half16(0, p + 8 * width);
        const bool inner = tx == 1 || tx == 2;
        const float16 a = inner ? vload_half16(0, p) : b, d = inner ? vload_half16(0, p + 12 * width) : c;
        add_four_columns(tx, a, b, c, d, SPREAD(wx[tx]), rows, &s);
    }
    return sum_up_four(s, SPREAD(steeper), per_range);
}

#endif
