/* Dilation of motion, and words that carry a vector of two components in 1/STEPS px to the pixel where it leads
   (nearest.h): for the dilated warp, and the peer to compare with. */

#include "stencil.h"
#include "thresholds.h"

/* What set the reach: docs/evaluation.md, "Methods". */
#define STEPS 32.0f     /* of a word, per pixel */
#define ZERO 32768.0f   /* a component of 0 in a word; no word is NOBODY */
#define LONGEST 1023.0f /* px: longer vectors are not carried */
#define FILL_REACH 5    /* px around a pixel without a vector in which one is searched */

/* Tap k of the 3x3 around a pixel, which comes first. */
#define TAP(k) (((k) + 4) % 9)
#define TAP_X(k) (TAP(k) % 3 - 1)
#define TAP_Y(k) (TAP(k) / 3 - 1)

/* The least depth of the 3x3 around LANES pixels from (x, y) on, and its pixels; of sky their own. */
INLINE Floats find_nearest(__global const float *depth, const int x, const int y, const int width, const int height,
                           Ints *nearest) {
    const Span p = span_at(x, y, width, height);
    Floats least = (Floats)(INFINITY);
    *nearest = clamped_beside(p, 0, 0);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const Floats z = beside(p, depth, TAP_X(k), TAP_Y(k));
        const Ints nearer = (z > 0.0f) & (z < least);
        least = nearer ? z : least;
        *nearest = nearer ? clamped_beside(p, TAP_X(k), TAP_Y(k)) : *nearest;
    }
    return least;
}

/* A component in px as half of a word, and back. */
INLINE Uints half_word(const Floats v) { return to_uints(v * STEPS + (ZERO + 0.5f)); }
INLINE Floats component(const Uints half_word) { return (to_floats(half_word) - ZERO) * (1.0f / STEPS); }

/* The vector in a word. */
INLINE float2 components(const uint word) {
    return ((float2)((float)(word & 0xFFFFu), (float)(word >> 16)) - ZERO) * (1.0f / STEPS);
}

/* Offers vectors of depth z, of `count` pixels at most, to the pixels at px of an image `width` wide; of those lanes
   that land there. */
INLINE void offer_vectors(const int pass, __global Key *keys, __global uint *winners, const int count, const int width,
                          const Ints lands, const Floats px_x, const Floats px_y, const Floats vector_x,
                          const Floats vector_y, const Floats z) {
    const Floats none = (Floats)(0.0f);
    const Ints dst = to_ints(lands ? px_y : none) * width + to_ints(lands ? px_x : none);
    const Uints word = half_word(lands ? vector_y : none) << 16 | half_word(lands ? vector_x : none);
    for (int k = 0; k < min(LANES, count); ++k)
        if (int_of(&lands, k)) offer(pass, keys, winners, int_of(&dst, k), float_of(&z, k), uint_of(&word, k));
}

/* The rendered frame, for a pixel that comes from `here` plus the vector in a word. `z`: depths of its pixels in the
   new frame; 0: it does not matter what they show. */
typedef struct {
    __global const float *z;
    int width, height;
    float2 here;
} Origin;

/* Whether a word of depth z leads to a surface that is nearer. */
INLINE bool leads_to_nearer(const Origin from, const uint word, const float z) {
    if (!from.z) return false;
    const float2 px = components(word) + from.here;
    const int x = clamp((int)px.x, 0, from.width - 1), y = clamp((int)px.y, 0, from.height - 1);
    return from.z[y * from.width + x] < NEARER * z;
}

/* The word of the nearest surface within FILL_REACH px of a pixel that none reached, of those that do not lead to a
   nearer one; NOBODY: there is none. */
INLINE uint nearest_beside(__global const Key *keys, __global const uint *winners, const int x, const int y,
                           const int width, const int height, const Origin from) {
    uint least = NOBODY, word = NOBODY;
    for (int reach = 1; reach <= FILL_REACH && word == NOBODY; ++reach)
        for (int dy = -reach; dy <= reach; ++dy)
            for (int dx = -reach; dx <= reach; dx += dy == -reach || dy == reach ? 1 : 2 * reach) { /* a ring */
                if (!inside(x + dx, y + dy, width, height)) continue;
                const int i = (y + dy) * width + x + dx;
                const uint depth_bits = depth_bits_of(keys, i), beside = winner_of(keys, winners, i);
                if (beside == NOBODY || depth_bits > least || (depth_bits == least && beside >= word)) continue;
                if (leads_to_nearer(from, beside, as_float(depth_bits))) continue;
                least = depth_bits;
                word = beside;
            }
    return word;
}
