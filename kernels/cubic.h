/* Cubic interpolation of half images, but for the corners of 4x4 taps, which weigh little. */

#include "simd_rgb.h"

/* What set the constants: docs/deviations.md, "Edges are as sharp as earlier frames were". */
#define LEAST_EDGE 0.1f /* range of the four inner taps, white being 1, above which an edge is steepened ... */
#define FULL_EDGE 0.3f /* ... and from which on it is so in full */
#define GOES_ON 0.6f /* of that range, between the means of outer taps on opposite sides: from there on it goes on */

#define CATMULL_ROM 0.5f /* slope */

/* How much sharper than Catmull-Rom's is interpolation. */
typedef struct {
    float slope; /* of the cubic */
    bool edges; /* whether edges are steepened: known when kernels are built */
    float steeper; /* by how much, midway between pixels */
    float per_range; /* 1 / the difference of codes between FULL_EDGE and LEAST_EDGE */
} Sharpening;

#define NO_EDGES(slope) {slope, false, 0.0f, 0.0f}

/* Weights of cubic convolution (Keys) of the four taps around t in [0, 1), with these slopes at the taps: with
   CATMULL_ROM it is Catmull-Rom, with more it is sharper. */
INLINE void cubic_weights(const Floats t, const float slope, Floats *weights) {
    const Floats t2 = t * t, t3 = t2 * t;
    weights[0] = slope * (2.0f * t2 - t - t3);
    weights[1] = 1.0f + (slope - 3.0f) * t2 + (2.0f - slope) * t3;
    weights[2] = slope * t + (3.0f - 2.0f * slope) * t2 + (slope - 2.0f) * t3;
    weights[3] = slope * (t3 - t2);
}

/* Weights of a sum. Those of all taps but the corners add up to 1. */
typedef struct {
    Floats x[4], y[4];
    Floats steeper; /* by how much an edge is steepened there: not at all at the centers of pixels */
    Sharpening sharp;
} Cubic;

INLINE void cubic_between(const Floats u, const Floats v, const Sharpening sharp, Cubic *c) {
    cubic_weights(u, sharp.slope, c->x);
    cubic_weights(v, sharp.slope, c->y);
    const Floats scale = wide_divide((Floats)(1.0f), 1.0f - (c->x[0] + c->x[3]) * (c->y[0] + c->y[3]));
    for (int k = 0; k < 4; ++k) c->x[k] *= scale;
    c->steeper = sharp.steeper * (1.0f - fabs(2.0f * u - 1.0f) * fabs(2.0f * v - 1.0f));
    c->sharp = sharp;
}

/* The sum, of type F, over taps in these columns and rows of an image, of finite numbers, clamped to the four inner
   taps. A column at a time: all of them at once take 48 registers of a GPU. Where the inner taps are of an edge that
   goes on, from one side of them to the other, the sum moves away from the middle of the pairs of outer taps. */
#define DEFINE_CUBIC(F, Image, load, of, some, cubic)                                                                  \
    INLINE F cubic(const int *columns, const int *rows, const Cubic *w, const int k, Image image) {                    \
        F total, low, high, above, below, left; /* sums of the outer taps on each side */                              \
        _Pragma("unroll") for (int n = 0; n < 4; ++n) { /* the inner columns first, which need most registers */       \
            const int tx = n < 2 ? n + 1 : 3 * (n - 2);                                                                \
            const F b = load(rows[1], columns[tx], image), c = load(rows[2], columns[tx], image);                      \
            F column = of(w->y[1], k) * b + of(w->y[2], k) * c;                                                        \
            if (n < 2) {                                                                                               \
                const F a = load(rows[0], columns[tx], image), d = load(rows[3], columns[tx], image);                  \
                column += of(w->y[0], k) * a + of(w->y[3], k) * d;                                                     \
                above = n == 0 ? a : above + a;                                                                        \
                below = n == 0 ? d : below + d;                                                                        \
                const F lower = b < c ? b : c, higher = b < c ? c : b;                                                 \
                low = n == 0 ? lower : low < lower ? low : lower;                                                      \
                high = n == 0 ? higher : high < higher ? higher : high;                                                \
            } else if (n == 2) {                                                                                       \
                left = b + c;                                                                                          \
            }                                                                                                          \
            total = n == 0 ? of(w->x[tx], k) * column : total + of(w->x[tx], k) * column;                              \
            if (n == 3 && w->sharp.edges) {                                                                            \
                const F right = b + c, range = high - low;                                                             \
                const F seen = range * w->sharp.per_range - LEAST_EDGE / (FULL_EDGE - LEAST_EDGE);                     \
                if (LANES == 1 || some(seen > 0.0f)) { /* GPUs have no registers for a branch */                       \
                    const F one = fabs(right - left), other = fabs(below - above);                                     \
                    const F least_x = left < right ? left : right, most_x = left < right ? right : left;               \
                    const F least_y = above < below ? above : below, most_y = above < below ? below : above;           \
                    const F middle =                                                                                   \
                        0.25f * ((least_x < least_y ? least_x : least_y) + (most_x < most_y ? most_y : most_x));       \
                    const F goes_on = 0.5f * (one < other ? other : one) - GOES_ON * range;                            \
                    const F edge = clamp(seen, 0.0f, 1.0f) * clamp(goes_on * w->sharp.per_range, 0.0f, 1.0f);          \
                    total -= of(w->steeper, k) * edge * (middle - total);                                              \
                }                                                                                                      \
            }                                                                                                          \
        }                                                                                                              \
        const F raised = total < low ? low : total;                                                                    \
        return high < raised ? high : raised;                                                                          \
    }

/* Of the pixel of lane k; and of those of part k, whose taps lie in rows. */
#define OF_LANE(v, k) ((float4)(float_of(&(v), k)))
#define load_tap(row, column, image) load_texel(column, (image) + 4 * (row))
#define load_run(row, column, image) load_texels(0, (image) + 4 * (row) + 4 * (column))
DEFINE_CUBIC(float4, __global const half *, load_tap, OF_LANE, any, cubic_of_lane)
#if LANES == 8
DEFINE_CUBIC(Texels, __global const half *, load_run, OF_TEXELS, ANY_TEXELS, cubic_of_run)
#else
#define cubic_of_run cubic_of_lane
#endif
