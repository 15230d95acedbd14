/* Keeping, per target pixel, the nearest of all fragments that are offered to it; ties go to the smallest index, so the
   result does not depend on the order of execution. Keys and winners start with all bits set. */

#include "simd.h"

#define NOBODY 0xFFFFFFFFu
#define GIVES_WAY 0x80000000u /* of a depth's bits: every offer without it is nearer */

#ifdef INT64_ATOMICS
#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable
typedef ulong Key; /* depth bits << 32 | index */
#else
typedef uint Key;   /* depth bits; the index is found in a second pass */
#endif

/* `depth_bits`: those of a positive float, perhaps with GIVES_WAY. One key for them and the index with 64-bit
   atomics; else pass 0 finds the least of them, pass 1 the least index of it. An offer that cannot win any more need
   not be made: a plain look costs less than an atomic, and one that comes too early only makes an offer in vain. It
   takes 32 bits, the depth's: devices need not load 64 as a whole, and a new depth with an old index would drop a
   tie. */
#define LOOKS 1 /* 0 for Oclgrind, which takes that look for a race */
#ifdef __ENDIAN_LITTLE__
#define DEPTH_WORD 1 /* of a key's two words */
#else
#define DEPTH_WORD 0
#endif

INLINE bool may_win(const int pass, __global const Key *keys, const int c, const uint depth_bits) {
#ifdef INT64_ATOMICS
    (void)pass;
    return !LOOKS || ((__global const uint *)keys)[2 * c + DEPTH_WORD] >= depth_bits;
#else
    return pass == 0 ? !LOOKS || keys[c] > depth_bits : keys[c] == depth_bits;
#endif
}

/* Returns whether nothing was offered before but what gives way. */
INLINE bool offer_bits(const int pass, __global Key *keys, __global uint *winners, const int c, const uint depth_bits,
                       const uint i) {
    if (!may_win(pass, keys, c, depth_bits)) return false;
#ifdef INT64_ATOMICS
    (void)winners;
    return (uint)(atom_min(keys + c, ((ulong)depth_bits << 32) | i) >> 32) & GIVES_WAY;
#else
    if (pass == 0) return atomic_min(keys + c, depth_bits) & GIVES_WAY;
    atomic_min(winners + c, i);
    return false;
#endif
}

INLINE bool offer(const int pass, __global Key *keys, __global uint *winners, const int c, const float z,
                  const uint i) {
    return offer_bits(pass, keys, winners, c, as_uint(z), i);
}

INLINE uint winner_of(__global const Key *keys, __global const uint *winners, const int c) {
#ifdef INT64_ATOMICS
    (void)winners;
    return (uint)keys[c];
#else
    (void)keys;
    return winners[c];
#endif
}

INLINE uint depth_bits_of(__global const Key *keys, const int c) {
#ifdef INT64_ATOMICS
    return (uint)(keys[c] >> 32);
#else
    return keys[c];
#endif
}

/* winner_of the first `count` of LANES pixels from c on, or all if it is more, as for load_some_floats of simd.h. */
INLINE Uints load_some_winners(const int count, __global const Key *keys, __global const uint *winners, const int c) {
    if (IS_WHOLE(count)) {
#ifdef INT64_ATOMICS
        return to_uints(load_uints(0, keys + c));
#else
        return load_uints(0, winners + c);
#endif
    }
    uint lanes[LANES];
    for (int k = 0; k < LANES; ++k) lanes[k] = winner_of(keys, winners, c + min(k, count - 1));
    return load_uints(0, lanes);
}

/* Sets all bits, for the next who offers. */
INLINE void forget(__global Key *keys, __global uint *winners, const int c) {
    keys[c] = (Key)(-1);
#ifdef INT64_ATOMICS
    (void)winners;
#else
    winners[c] = NOBODY;
#endif
}
