/* Surfaces of a rendered frame: which neighboring pixels show one surface (for 'Warping' and the background), and which
   pixels cannot hold the color of another one: those are what level 0 of the background shows (background.cl).
   Where depth changes by little, or by much between two flat surfaces, links follow from it without a division. */

#include "frame.h"
#include "stencil.h"
#include "nearest.h"
#include "blocks.h"

/* What set the thresholds: docs/deviations.md, "Fragments cover what their pixel maps to", "Nothing is collected
   beside movers and nearer surfaces". */
#define SURFACE_STEP 0.02f /* relative step of inverse depth between neighbors of one surface ... */
#define SURFACE_CURVATURE 0.005f /* ... or relative deviation from the plane through them, where they are steeper */
#define SMALL_STEP 0.0199f /* relative step of depth that is within SURFACE_STEP, however that is rounded ... */
#define LARGE_STEP 0.032f /* ... and a depth step above this and, next to a small one, above SURFACE_CURVATURE */

#define GROW 2 /* px around dynamic or nearer fragments where colors may be mixed with theirs */
#define MIXES_IN 0.9f

#define REACH 2 /* px around a pixel that are looked at: GROW, and 2 for links */
#define GROUP 128 /* work-items of a work-group */

#if LANES == 8

#define MORE 4 /* px that are loaded before and after those of a row */

/* A rendered frame and a place in it: pixels from (x, y) on. `inner`: all that is looked at lies inside. */
typedef struct {
    int width, height, x, y;
    bool inner;
    __global const float *depth;
    __global const uchar *dynamic_mask;
} Place;

INLINE Span span_of(const Place p) {
    const Span s = {p.x, p.y, p.width, p.height, p.inner};
    return s;
}

/* Depth of the pixels at an offset, NaN outside of the image; and whether they are dynamic, 0 outside. */
INLINE Floats depth_beside(const Place p, const int dx, const int dy) {
    const Floats z = beside(span_of(p), p.depth, dx, dy);
    return is_inside(span_of(p), dx, dy) ? z : (Floats)(NAN);
}

INLINE Ints dynamic_beside(const Place p, const int dx, const int dy) {
    const Ints dynamic = bytes_beside(span_of(p), p.dynamic_mask, dx, dy);
    return is_inside(span_of(p), dx, dy) ? dynamic : (Ints)(0);
}

/* Gives which of them have nothing dynamic within GROW. */
INLINE Ints nothing_moves(const Place p) {
    Ints moving = 0;
    for (int dy = -GROW; dy <= GROW; ++dy)
        for (int dx = -GROW; dx <= GROW; ++dx) moving |= dynamic_beside(p, dx, dy);
    return moving == 0;
}

/* The least depth within GROW of each. Gives whether nothing near any of them is dynamic. */
INLINE bool look_around(const Place p, Floats *nearest) {
    if (p.inner) { /* 4 pixels more to each side: columns first, which pixels share */
        const int first = (p.y - GROW) * p.width + p.x - MORE;
        float16 column = INFINITY;
        uchar16 moving = 0;
        for (int row = 0; row <= 2 * GROW; ++row) {
            const float16 z = vload16(0, p.depth + first + row * p.width);
            column = z < column ? z : column;
            moving |= vload16(0, p.dynamic_mask + first + row * p.width);
        }
        const float8 outer = column.s23456789 < column.s6789abcd ? column.s23456789 : column.s6789abcd;
        const float8 inner = column.s3456789a < column.s56789abc ? column.s3456789a : column.s56789abc;
        const float8 beside = outer < inner ? outer : inner;
        *nearest = beside < column.s456789ab ? beside : column.s456789ab;
        const ulong2 bits = as_ulong2(moving);
        return (bits.x | bits.y) == 0;
    }
    Floats least = INFINITY;
    for (int dy = -GROW; dy <= GROW; ++dy)
        for (int dx = -GROW; dx <= GROW; ++dx) {
            const Floats beside = depth_beside(p, dx, dy);
            least = beside < least ? beside : least;
        }
    *nearest = least;
    return ALL(nothing_moves(p));
}

#else

#define ROWS (2 * REACH + 1)
#define COLUMNS (GROUP + 2 * REACH)
#define MASK_BITS 2 /* of a value of dynamic_mask */

/* The neighborhood of a work-group's pixels, which its work-items load together: columns of ROWS pixels. */
typedef struct {
    float depth[ROWS][COLUMNS], nearest[COLUMNS];  /* NaN outside of the image; the least of a column */
    int dynamic[COLUMNS];                          /* values of dynamic_mask, MASK_BITS each; 0 outside */
} Tile;

/* A pixel, and the first column of `tile` that it looks at. */
typedef struct {
    int width, height, x, y, column;
    __local const Tile *tile;
} Place;

INLINE void load_column(const int column, const int x, const int y, const int width, const int height,
                        __global const float *depth, __global const uchar *dynamic_mask, __local Tile *tile) {
    float nearest = INFINITY;
    int dynamic = 0;
    for (int row = 0; row < ROWS; ++row) {
        const bool is_inside = inside(x, y + row, width, height);
        const int i = (y + row) * width + x;
        const float z = is_inside ? depth[i] : NAN;
        tile->depth[row][column] = z;
        nearest = fmin(nearest, z);
        if (is_inside) dynamic |= dynamic_mask[i] << row * MASK_BITS;
    }
    tile->nearest[column] = nearest;
    tile->dynamic[column] = dynamic;
}

INLINE float depth_beside(const Place p, const int dx, const int dy) {
    return p.tile->depth[REACH + dy][p.column + REACH + dx];
}

INLINE int dynamic_beside(const Place p, const int dx, const int dy) {
    return p.tile->dynamic[p.column + REACH + dx] >> (REACH + dy) * MASK_BITS & ((1 << MASK_BITS) - 1);
}

INLINE int nothing_moves(const Place p) {
    int moving = 0;
    for (int dx = -GROW; dx <= GROW; ++dx) moving |= p.tile->dynamic[p.column + REACH + dx];
    return moving == 0;
}

INLINE bool look_around(const Place p, float *nearest) {
    *nearest = INFINITY;
    for (int dx = -GROW; dx <= GROW; ++dx) *nearest = fmin(*nearest, p.tile->nearest[p.column + REACH + dx]);
    return nothing_moves(p);
}

#endif

/* 0 sky, -1 none. */
INLINE Floats inverse_depth_beside(const Place p, const int dx, const int dy) {
    const Floats z = depth_beside(p, dx, dy);
    return z > 0.0f ? wide_divide((Floats)(1.0f), z) : (Floats)(-1.0f);
}

/* Whether b, next to a, continues a's surface; a2 lies behind a, b2 behind b. Inverse depths. */
INLINE Ints continues(const Floats a2, const Floats a, const Floats b, const Floats b2) {
    const Floats size = SURFACE_CURVATURE * fmax(a, b);
    const Ints near = (fabs(a - b) <= SURFACE_STEP * fmax(a, b)) | ((a2 > 0.0f) & (fabs((a - a2) - (b - a)) <= size))
                      | ((b2 > 0.0f) & (fabs((b2 - b) - (b - a)) <= size));
    const Ints sky = (a == 0.0f) | (b == 0.0f);
    return (a >= 0.0f) & (b >= 0.0f) & ((sky & (a == b)) | ((!sky) & near));
}

/* Links along one axis, by inverse depth. */
INLINE Ints links_by_inverse_depth(const Place p, const int axis) {
    const int dx = axis == 0, dy = axis == 1;
    const Floats a = inverse_depth_beside(p, 0, 0);
    const Floats ahead = inverse_depth_beside(p, dx, dy), behind = inverse_depth_beside(p, -dx, -dy);
    const Ints to_ahead = continues(behind, a, ahead, inverse_depth_beside(p, 2 * dx, 2 * dy));
    const Ints to_behind = continues(ahead, a, behind, inverse_depth_beside(p, -2 * dx, -2 * dy));
    return (to_ahead ? (Ints)(LINK_RIGHT << axis) : (Ints)(0)) | (to_behind ? (Ints)(LINK_LEFT << axis) : (Ints)(0));
}

INLINE Ints small_step(const Floats a, const Floats b) {
    return (a == b) | (fabs(a - b) <= SMALL_STEP * (a < b ? a : b));
}

INLINE Ints large_step(const Floats a, const Floats b) { return fabs(a - b) > LARGE_STEP * (a < b ? a : b); }

/* Links by depth; along an axis where that does not decide for all, by inverse depth. */
INLINE Ints links_by_depth(const Place p) {
    const Floats z = depth_beside(p, 0, 0);
    Ints links = 0;
    if (LANES > 1) { /* most rows change by little */
        const Ints flat = (z > 0.0f) & small_step(z, depth_beside(p, 1, 0)) & small_step(z, depth_beside(p, 0, 1))
                          & small_step(z, depth_beside(p, -1, 0)) & small_step(z, depth_beside(p, 0, -1));
        if (ALL(flat)) return (Ints)(LINK_RIGHT | LINK_DOWN | LINK_LEFT | LINK_UP);
    }
    for (int axis = 0; axis < 2; ++axis) {
        const int dx = axis == 0, dy = axis == 1;
        const Floats ahead = depth_beside(p, dx, dy), behind = depth_beside(p, -dx, -dy);
        const Ints to_ahead = small_step(z, ahead), to_behind = small_step(z, behind);
        Ints clear = z > 0.0f;
        clear &= to_ahead | (large_step(z, ahead) & to_behind & small_step(ahead, depth_beside(p, 2 * dx, 2 * dy)));
        clear &= to_behind | (large_step(z, behind) & to_ahead & small_step(behind, depth_beside(p, -2 * dx, -2 * dy)));
        if (ALL(clear)) {
            links |= to_ahead ? (Ints)(LINK_RIGHT << axis) : (Ints)(0);
            links |= to_behind ? (Ints)(LINK_LEFT << axis) : (Ints)(0);
        } else {
            links |= links_by_inverse_depth(p, axis);
        }
    }
    return links;
}

/* Links to neighbors that are equally static or dynamic. */
INLINE Ints links_by_motion(const Place p) {
    const Ints own = dynamic_beside(p, 0, 0);
    const Ints right = dynamic_beside(p, 1, 0) == own, down = dynamic_beside(p, 0, 1) == own;
    const Ints left = dynamic_beside(p, -1, 0) == own, up = dynamic_beside(p, 0, -1) == own;
    return (right ? (Ints)(LINK_RIGHT) : (Ints)(0)) | (down ? (Ints)(LINK_DOWN) : (Ints)(0))
           | (left ? (Ints)(LINK_LEFT) : (Ints)(0)) | (up ? (Ints)(LINK_UP) : (Ints)(0));
}

/* The background's state before collection: the state of level 0, the receivers of fragments that may fill it, and
   those of fragments pushed to level 1. */
typedef struct {
    __global uchar *state;
    __global Key *fill_keys;
    __global uint *fill_winners;
    __global Key *push_keys;
    __global uint *push_winners;
} Collecting;

/* links: which of the four neighbors belong to the same surface and are equally static or dynamic. To `collect`:
   texels are SHOWN where depth is valid and no pixel within GROW is dynamic or nearer. Of a `single` level, which
   remembers what movers hide, those are an EDGE where one is nearer, but none is dynamic. The others are EMPTY, and no
   fragment is offered to them yet, nor to level 1. */
INLINE void find(const Place p, const int collect, const bool single, __global uchar *links, const Collecting to) {
    const Floats z = depth_beside(p, 0, 0);
    Floats nearest;
    const bool still = look_around(p, &nearest);
    const Ints settled = (z > 0.0f) & (still ? ALL_LANES : nothing_moves(p));
    const Ints clean = settled & !(nearest < z * MIXES_IN);
    Ints linked = links_by_depth(p);
    if (!still) linked &= links_by_motion(p);
    const int i = p.y * p.width + p.x, count = min(LANES, p.width - p.x);
    store_some_bytes(to_bytes(linked), count, links + i);
    if (!collect) return;
    const Ints closed = single ? settled : clean;
    store_some_bytes(to_bytes(clean ? (Ints)(SHOWN) : closed ? (Ints)(EDGE) : (Ints)(EMPTY)), count, to.state + i);
    if (!single && !((p.x | p.y) & 1)) {
        const int level_width = (p.width + 1) / 2, first = p.y / 2 * level_width + p.x / 2;
        for (int k = 0; k < (count + 1) / 2; ++k) forget(to.push_keys, to.push_winners, first + k);
    }
    if (ALL(closed)) return;
    for (int k = 0; k < count; ++k) forget(to.fill_keys, to.fill_winners, i + k);
}

WIDE __kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
find_links(__constant Frame *frame, __global const float *depth, __global const uchar *dynamic_mask,
           __global const int *last_stir, __global uchar *links, __global uchar *state, __global Key *fill_keys,
           __global uint *fill_winners, __global Key *push_keys, __global uint *push_winners) {
    const int source_width = frame->source_width, source_height = frame->source_height;
    const int collect = frame->collects && frame->has_previous;
    const int src_x = get_global_id(0) * LANES, src_y = get_global_id(1);
    const Collecting to = {state, fill_keys, fill_winners, push_keys, push_winners};
#if LANES == 8
    if (src_x >= source_width || src_y >= source_height) return;
    if (links_are_known(block_of(src_x, src_y, source_width), frame, last_stir)) return;
    const bool inner =
        src_x >= MORE && src_x + LANES + MORE <= source_width && src_y >= REACH && src_y + REACH < source_height;
    Place p = {source_width, source_height, src_x, src_y, false, depth, dynamic_mask};
    if (inner) {
        p.inner = true;
        find(p, collect, frame->levels == 1, links, to);
    } else {
        find(p, collect, frame->levels == 1, links, to);
    }
#else
    __local Tile tile;
    const int lane = get_local_id(0), first_x = src_x - lane - REACH;
    for (int column = lane; column < COLUMNS; column += GROUP)
        load_column(column, first_x + column, src_y - REACH, source_width, source_height, depth, dynamic_mask, &tile);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (src_x >= source_width || links_are_known(block_of(src_x, src_y, source_width), frame, last_stir)) return;
    const Place p = {source_width, source_height, src_x, src_y, lane, &tile};
    find(p, collect, frame->levels == 1, links, to);
#endif
}
