/* Lists of the few pixels at which stages have work. One kernel lists them, in no particular order, and others walk the
   list instead of a mask of the whole image. Element 0 of a list is its length, which an earlier kernel sets to 0, and
   there is room for every pixel behind it. Results must not depend on the order. */

#include "simd.h"

#define WALK_GROUP 64 /* work-items of a group that walks a list ... */
#define TEAM (LANES == 1 ? 8 : 1) /* ... and of a team, which works on one pixel */
#define TEAMS (WALK_GROUP / TEAM)
#define NO_ENTRY 0xFFFFFFFFu

/* Waits for the team. CPUs have teams of one, and need not keep all work-items of a group in step. */
#define WAIT_FOR_TEAM()                                                                                                \
    if (TEAM > 1) barrier(CLK_LOCAL_MEM_FENCE)

/* Before a kernel that walks a list. */
#define WALK __attribute__((vec_type_hint(float4), reqd_work_group_size(WALK_GROUP, 1, 1)))

#define LISTED(list, i) ((list)[1 + (i)])

/* Entry i of the list of open pixels; NO_ENTRY behind its end. */
INLINE uint entry_of(__global const uint *open, const uint i) { return i < open[0] ? LISTED(open, i) : NO_ENTRY; }

INLINE void append(const uint entry, __global uint *list) { LISTED(list, atomic_inc(list)) = entry; }

/* Appends the entries of the lanes that `has` tells. With one lane there is one atomic for a group, all of which must
   come here. `shared`: two numbers of the group. */
INLINE void append_lanes(const Ints has, const Uints entries, __global uint *list, __local uint *shared) {
    if (LANES > 1) {
        for (int k = 0; ANY(has) && k < LANES; ++k)
            if (int_of(&has, k)) append(uint_of(&entries, k), list);
    } else {
        const bool is_first = get_local_id(0) == 0 && get_local_id(1) == 0;
        if (is_first) shared[0] = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        const uint place = int_of(&has, 0) ? atomic_inc(shared) : 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (is_first && shared[0]) shared[1] = atomic_add(list, shared[0]);
        barrier(CLK_LOCAL_MEM_FENCE);
        if (int_of(&has, 0)) LISTED(list, shared[1] + place) = uint_of(&entries, 0);
    }
}

/* Work-items of a group that looks for a value in a mask, and the bytes that each of them looks at. */
#define SCAN_GROUP 64
#define SCAN_BYTES 16

/* Before such a kernel. */
#define SCAN_FLAT __attribute__((vec_type_hint(uchar16), reqd_work_group_size(SCAN_GROUP, 1, 1)))

/* Finds a value in the bytes of a mask that are the work-group's, up to `end`. Gives the first of these bytes; the
   places after it that have the value are the first `found_count` of `found`, in no particular order. */
INLINE int scan_for(const uchar value, __global const uchar *mask, const int end, __local ushort *found,
                    __local uint *found_count) {
    const int own = get_local_id(0) * SCAN_BYTES, at = get_global_id(0) * SCAN_BYTES;
    if (own == 0) *found_count = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    ulong2 equal = (ulong2)(1);
    if (at + SCAN_BYTES <= end) equal = as_ulong2(as_uchar16(*(__global const uint4 *)(mask + at)) == (uchar16)(value));
    for (int k = 0; (equal.x | equal.y) && k < min(SCAN_BYTES, end - at); ++k)
        if (mask[at + k] == value) found[atomic_inc(found_count)] = (ushort)(own + k);
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE); /* the caller may write to the mask */
    return at - own;
}
