/* Looking around a hole in eight directions (hidden_parts.cl, holes.cl). */

#include "simd.h"

#define DIRECTIONS 8             /* direction k + 4 is opposite to k */
#define AT_ONCE 16 /* pixels that are read at once, so a march rarely waits for memory */

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

/* Which of AT_ONCE steps from `first` on, up to `last`, meet a pixel that has another value in a mask, in bits; `offset`:
   of a step. */
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
    for (int t = 1; t <= steps; t += AT_ONCE) {
        const uint others = others_from(t, steps, dst, offset, mask, value);
        if (others) return min(t + first_of(others), steps);
    }
    return 0;
}

/* A value for each direction. On GPUs, which index no registers, it is a vector: AT and SET select among its
   components. FLOATS_AT and INTS_AT give those of LANES directions from k on, SET_FLOATS and SET_INTS store them. */
#if LANES == 8
typedef int DirectionInts[DIRECTIONS];
typedef float DirectionFloats[DIRECTIONS];
#define AT(values, k) ((values)[k])
#define SET(values, k, value) ((values)[k] = (value))
#define FLOATS_AT(values, k) load_floats(0, (values) + (k))
#define INTS_AT(values, k) load_ints(0, (values) + (k))
#define SET_FLOATS(values, k, value) store_floats(value, 0, (values) + (k))
#define SET_INTS(values, k, value) store_ints(value, 0, (values) + (k))
#else
typedef int8 DirectionInts;
typedef float8 DirectionFloats;
#define AT(values, k)                                                                                                  \
    ((k) < 4 ? ((k) < 2 ? ((k) == 0 ? (values).s0 : (values).s1) : ((k) == 2 ? (values).s2 : (values).s3))             \
             : ((k) < 6 ? ((k) == 4 ? (values).s4 : (values).s5) : ((k) == 6 ? (values).s6 : (values).s7)))
#define SET(values, k, value)                                                                                          \
    ((values).s0 = (k) == 0 ? (value) : (values).s0, (values).s1 = (k) == 1 ? (value) : (values).s1,                   \
     (values).s2 = (k) == 2 ? (value) : (values).s2, (values).s3 = (k) == 3 ? (value) : (values).s3,                   \
     (values).s4 = (k) == 4 ? (value) : (values).s4, (values).s5 = (k) == 5 ? (value) : (values).s5,                   \
     (values).s6 = (k) == 6 ? (value) : (values).s6, (values).s7 = (k) == 7 ? (value) : (values).s7)
#define FLOATS_AT AT
#define INTS_AT AT
#define SET_FLOATS SET
#define SET_INTS SET
#endif

/* Whether direction k is among those of a set, which has a bit for each. */
INLINE bool has(const int directions, const int k) { return (directions >> k) & 1; }

/* The same of LANES directions from k on, ... */
INLINE Ints wide_has(const int directions, const int k) { return ((Ints)(directions) >> (k + LANE_NUMBERS) & 1) != 0; }

/* ... and the set of those for which a condition holds. */
INLINE int set_of(const Ints condition, const int k) {
    int lane_bit[LANES], bits = 0;
    store_ints(condition ? (Ints)(1) << (k + LANE_NUMBERS) : (Ints)(0), 0, lane_bit);
    for (int lane = 0; lane < LANES; ++lane) bits |= lane_bit[lane];
    return bits;
}
