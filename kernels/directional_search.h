/* Looking around a hole in eight directions (hidden_parts.cl, holes.cl). */

#include "simd.h"

#define DIRECTIONS 8             /* direction k + 4 is opposite to k */
/* Pixels that are read at once: GPUs' marches rarely wait for memory then. */
#define AT_ONCE (LANES == 1 ? 16 : 1)

INLINE int2 direction(const int k) {
    const int quarter = k & 3, sign = k < 4 ? 1 : -1;
    return (int2)(quarter == 3 ? -sign : quarter == 2 ? 0 : sign, quarter == 0 ? 0 : sign);
}

#define DIAGONAL 1.41421356f /* px per step of odd directions; others: 1 */
INLINE float step_length(const int2 d) { return d.x && d.y ? DIAGONAL : 1.0f; }

INLINE int room(const int at, const int direction, const int side) {
    return direction > 0 ? side - 1 - at : direction < 0 ? at : INT_MAX;
}

/* Steps from (x, y) that stay in the image and within `reach` px. */
INLINE int steps_within(const int reach, const int2 d, const int x, const int y, const int width, const int height) {
    const float step = step_length(d);
    int steps = min(min(room(x, d.x, width), room(y, d.y, height)), (int)((float)reach / step) + 1);
    while (steps > 0 && (float)steps * step > (float)reach) --steps;
    return steps;
}

/* Which of AT_ONCE steps from `first` on, up to `last`, meet a pixel that has another value in a mask, in bits;
   `offset`: of a step. */
INLINE uint others_from(const int first, const int last, const int dst, const int offset, __global const uchar *mask,
                        const uchar value) {
    uint others = 0;
#pragma unroll
    for (int k = 0; k < AT_ONCE; ++k) others |= (uint)(mask[dst + min(first + k, last) * offset] != value) << k;
    return others;
}

INLINE int first_of(const uint bits) { return 31 - (int)clz(bits & -bits); }

/* The first of `steps` steps that meets a pixel with another value in a mask, counted from 1; 0: none. */
INLINE int first_other(const int dst, const int offset, const int steps, __global const uchar *mask,
                       const uchar value) {
    if (LANES > 1) {
        int t = 1;
        for (int at = dst + offset; t <= steps && mask[at] == value; at += offset) ++t;
        return t <= steps ? t : 0;
    }
    for (int t = 1; t <= steps; t += AT_ONCE) {
        const uint others = others_from(t, steps, dst, offset, mask, value);
        if (others) return min(t + first_of(others), steps);
    }
    return 0;
}

/* Whether direction k is among those of a set, which has a bit for each. */
INLINE bool has(const int directions, const int k) { return (directions >> k) & 1; }
