/* Cubic (Catmull-Rom) interpolation of half images, but for the corners of 4x4 taps, which weigh little. */

#include "simd_rgb.h"

/* Weights of the four taps around t in [0, 1). */
INLINE void cubic_weights(const Floats t, Floats *weights) {
    const Floats t2 = t * t, t3 = t2 * t;
    weights[0] = -0.5f * t + t2 - 0.5f * t3;
    weights[1] = 1.0f - 2.5f * t2 + 1.5f * t3;
    weights[2] = 0.5f * t + 2.0f * t2 - 1.5f * t3;
    weights[3] = 0.5f * t3 - 0.5f * t2;
}

/* Makes the weights of all taps but the corners add up to 1. */
INLINE void leave_out_corners(Floats *wx, const Floats *wy) {
    const Floats scale = wide_divide((Floats)(1.0f), 1.0f - (wx[0] + wx[3]) * (wy[0] + wy[3]));
    for (int k = 0; k < 4; ++k) wx[k] *= scale;
}

/* The pixels of a part, whose taps lie in a row from index `first` on, clamped to the four inner taps. Of finite
   numbers. A column at a time: all of them at once take 48 registers of a GPU. */
INLINE Texels cubic_of_run(const int first, const Floats *wx, const Floats *wy, const int part, const int width,
                           __global const half *image) {
    Texels total, low, high;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        __global const half *p = image + 4 * (first + tx);
        const Texels b = load_texels(0, p + 4 * width), c = load_texels(0, p + 8 * width);
        Texels column = OF_TEXELS(wy[1], part) * b + OF_TEXELS(wy[2], part) * c;
        if (tx == 1 || tx == 2) {
            column +=
                OF_TEXELS(wy[0], part) * load_texels(0, p) + OF_TEXELS(wy[3], part) * load_texels(0, p + 12 * width);
            const Texels lower = b < c ? b : c, higher = b < c ? c : b;
            low = tx == 1 ? lower : low < lower ? low : lower;
            high = tx == 1 ? higher : high < higher ? higher : high;
        }
        total = tx == 0 ? OF_TEXELS(wx[0], part) * column : total + OF_TEXELS(wx[tx], part) * column;
    }
    const Texels raised = total < low ? low : total;
    return high < raised ? high : raised;
}

/* The same of the pixel of lane k from taps in any columns and rows, which begin at indices `rows`. */
INLINE float4 cubic_of_lane(const int *columns, const int *rows, const Floats *wx, const Floats *wy, const int k,
                            __global const half *image) {
    float4 total = (float4)(0.0f), low = total, high = total;
#pragma unroll
    for (int tx = 0; tx < 4; ++tx) {
        const float4 b = load_texel(rows[1] + columns[tx], image), c = load_texel(rows[2] + columns[tx], image);
        float4 column = float_of(&wy[1], k) * b + float_of(&wy[2], k) * c;
        if (tx == 1 || tx == 2) {
            const float4 a = load_texel(rows[0] + columns[tx], image), d = load_texel(rows[3] + columns[tx], image);
            column += float_of(&wy[0], k) * a + float_of(&wy[3], k) * d;
            const float4 lower = b < c ? b : c, higher = b < c ? c : b;
            low = tx == 1 ? lower : low < lower ? low : lower;
            high = tx == 1 ? higher : high < higher ? higher : high;
        }
        total = tx == 0 ? float_of(&wx[0], k) * column : total + float_of(&wx[tx], k) * column;
    }
    const float4 raised = total < low ? low : total;
    return high < raised ? high : raised;
}
