/* Cubic interpolation of half images, but for the corners of 4x4 taps, which weigh little. */

#include "simd_rgb.h"

#define CATMULL_ROM 0.5f /* slope */

/* Weights of cubic convolution (Keys) of the four taps around t in [0, 1), with these slopes at the taps: with
   CATMULL_ROM it is Catmull-Rom, with more it is sharper. */
INLINE void cubic_weights(const Floats t, const float slope, Floats *weights) {
    const Floats t2 = t * t, t3 = t2 * t;
    weights[0] = slope * (2.0f * t2 - t - t3);
    weights[1] = 1.0f + (slope - 3.0f) * t2 + (2.0f - slope) * t3;
    weights[2] = slope * t + (3.0f - 2.0f * slope) * t2 + (slope - 2.0f) * t3;
    weights[3] = slope * (t3 - t2);
}

/* Makes the weights of all taps but the corners add up to 1. */
INLINE void leave_out_corners(Floats *wx, const Floats *wy) {
    const Floats scale = wide_divide((Floats)(1.0f), 1.0f - (wx[0] + wx[3]) * (wy[0] + wy[3]));
    for (int k = 0; k < 4; ++k) wx[k] *= scale;
}

#define NOT_STEEPER 0.0f /* for `per_range`: interpolation alone */

/* Interpolation of colors of type F, of finite numbers, a column at a time: all of them at once take 48 registers of a
   GPU. The result is steepened: it moves away from the middle of its taps, by `steeper` of its distance, in proportion
   to their range, up to 1 / per_range. Then it is clamped to the four inner taps. Of the first and the last column,
   only the taps b and c count. */
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

#if LANES == 8
DEFINE_CUBIC(Texels, RunSums, add_run_column, run_sums_up)
#else
#define RunSums CubicSums
#define add_run_column add_column
#define run_sums_up sums_up
#endif

/* The pixels of a part, whose taps lie in a row from index `first` on. */
INLINE Texels cubic_of_run(const int first, const Floats *wx, const Floats *wy, const int part, const int width,
                           __global const half *image, const Floats steeper, const float per_range) {
    const Texels rows[4] = {OF_TEXELS(wy[0], part), OF_TEXELS(wy[1], part), OF_TEXELS(wy[2], part),
                            OF_TEXELS(wy[3], part)};
    RunSums s;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        __global const half *p = image + 4 * (first + tx);
        const Texels b = load_texels(0, p + 4 * width), c = load_texels(0, p + 8 * width);
        const bool inner = tx == 1 || tx == 2;
        const Texels a = inner ? load_texels(0, p) : b, d = inner ? load_texels(0, p + 12 * width) : c;
        add_run_column(tx, a, b, c, d, OF_TEXELS(wx[tx], part), rows, &s);
    }
    return run_sums_up(s, OF_TEXELS(steeper, part), per_range);
}

/* The weights of lane k for rows of taps. */
INLINE void rows_of_lane(const Floats *wy, const int k, float4 *rows) {
    for (int ty = 0; ty < 4; ++ty) rows[ty] = (float4)(float_of(&wy[ty], k));
}

/* The same of the pixel of lane k from taps in any columns and rows, which begin at indices `rows`. */
INLINE float4 cubic_of_lane(const int *columns, const int *rows, const Floats *wx, const Floats *wy, const int k,
                            __global const half *image, const Floats steeper, const float per_range) {
    float4 row_weights[4];
    rows_of_lane(wy, k, row_weights);
    CubicSums s;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        const float4 b = load_texel(rows[1] + columns[tx], image), c = load_texel(rows[2] + columns[tx], image);
        const bool inner = tx == 1 || tx == 2;
        const float4 a = inner ? load_texel(rows[0] + columns[tx], image) : b,
                     d = inner ? load_texel(rows[3] + columns[tx], image) : c;
        add_column(tx, a, b, c, d, (float4)(float_of(&wx[tx], k)), row_weights, &s);
    }
    return sums_up(s, (float4)(float_of(&steeper, k)), per_range);
}
