/* Cubic interpolation of half images, but for the corners of 4x4 taps, which weigh little. */

#include "simd_rgb.h"

/* What set the constants: docs/deviations.md, "Edges are as sharp as earlier frames were". */
#define LEAST_EDGE 0.1f /* range of the four inner taps, white being 1, above which an edge is steepened ... */
#define FULL_EDGE 0.3f /* ... and from which on it is so in full */

#define CATMULL_ROM 0.5f /* slope */

/* How much sharper than Catmull-Rom's is interpolation. */
typedef struct {
    float slope; /* of the cubic */
    float steeper; /* by how much edges are steepened, midway between pixels */
    float per_range; /* 1 / the difference of codes between FULL_EDGE and LEAST_EDGE; 0: none is steepened */
} Sharpening;

#define NOT_STEEPER(slope) {slope, 0.0f, 0.0f}

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
    float per_range; /* as in Sharpening */
} Cubic;

INLINE void cubic_between(const Floats u, const Floats v, const Sharpening sharp, Cubic *c) {
    cubic_weights(u, sharp.slope, c->x);
    cubic_weights(v, sharp.slope, c->y);
    const Floats scale = wide_divide((Floats)(1.0f), 1.0f - (c->x[0] + c->x[3]) * (c->y[0] + c->y[3]));
    for (int k = 0; k < 4; ++k) c->x[k] *= scale;
    c->steeper = sharp.steeper * (1.0f - fabs(2.0f * u - 1.0f) * fabs(2.0f * v - 1.0f));
    c->per_range = sharp.per_range;
}

/* Sums of type F over taps in these columns and rows of an image, of finite numbers, a column at a time: all of them at
   once take 48 registers of a GPU. Where the four inner taps are of an edge, the sum moves away from the middle of all
   twelve. Then it is clamped to the inner ones. */
#define DEFINE_CUBIC(F, Image, load, of, widen, Sums, add_column, cubic)                                               \
    typedef struct {                                                                                                   \
        F sum, low, high;                                                                                              \
    } Sums;                                                                                                            \
    INLINE void widen(const F a, const F b, F *low, F *high) {                                                         \
        const F lower = a < b ? a : b, higher = a < b ? b : a;                                                         \
        *low = *low < lower ? *low : lower;                                                                            \
        *high = *high < higher ? higher : *high;                                                                       \
    }                                                                                                                  \
    INLINE void add_column(const int tx, const int column, const int *rows, const Cubic *w, const int k, Image image,  \
                           Sums *s) {                                                                                  \
        const F b = load(rows[1] + column, image), c = load(rows[2] + column, image);                                  \
        F sum = of(w->y[1], k) * b + of(w->y[2], k) * c;                                                               \
        if (tx == 1 || tx == 2)                                                                                        \
            sum += of(w->y[0], k) * load(rows[0] + column, image) + of(w->y[3], k) * load(rows[3] + column, image);    \
        if (tx == 1) {                                                                                                 \
            s->low = b < c ? b : c;                                                                                    \
            s->high = b < c ? c : b;                                                                                   \
        }                                                                                                              \
        if (tx == 2) widen(b, c, &s->low, &s->high);                                                                   \
        s->sum = tx == 0 ? of(w->x[0], k) * sum : s->sum + of(w->x[tx], k) * sum;                                      \
    }                                                                                                                  \
    INLINE F cubic(const int *columns, const int *rows, const Cubic *w, const int k, Image image) {                    \
        const int first = rows[1] + columns[1], width = rows[2] - rows[1];                                             \
        Sums s;                                                                                                        \
        add_column(0, columns[0], rows, w, k, image, &s);                                                              \
        add_column(1, columns[1], rows, w, k, image, &s);                                                              \
        add_column(2, columns[2], rows, w, k, image, &s);                                                              \
        add_column(3, columns[3], rows, w, k, image, &s);                                                              \
        const F share = (s.high - s.low) * w->per_range - LEAST_EDGE / (FULL_EDGE - LEAST_EDGE);                       \
        if (any(share > 0.0f)) {                                                                                       \
            F least = s.low, most = s.high;                                                                            \
            _Pragma("unroll 1") for (int tap = 0; tap < 4; ++tap) { /* again: to keep them takes as many registers */  \
                const int across = tap & 1, far = 3 * (tap >> 1) - 1;                                                  \
                widen(load(first + across + far * width, image), load(first + far + across * width, image), &least,    \
                      &most);                                                                                          \
            }                                                                                                          \
            s.sum += of(w->steeper, k) * clamp(share, 0.0f, 1.0f) * (s.sum - 0.5f * (least + most));                   \
        }                                                                                                              \
        const F raised = s.sum < s.low ? s.low : s.sum;                                                                \
        return s.high < raised ? s.high : raised;                                                                      \
    }

/* Of the pixel of lane k; and of those of part k, whose taps lie in rows. */
#define OF_LANE(v, k) ((float4)(float_of(&(v), k)))
#define load_run(i, image) load_texels(0, (image) + 4 * (i))
DEFINE_CUBIC(float4, __global const half *, load_texel, OF_LANE, widen, CubicSums, add_column, cubic_of_lane)
#if LANES == 8
DEFINE_CUBIC(Texels, __global const half *, load_run, OF_TEXELS, widen_run, RunSums, add_run_column, cubic_of_run)
#else
#define cubic_of_run cubic_of_lane
#endif
