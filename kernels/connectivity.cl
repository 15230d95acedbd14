/* Surfaces of a rendered frame: which neighboring pixels show one surface (for 'Warping' and the background), and which
   pixels cannot hold the color of another one: those are what level 0 of the background shows (background.cl).
   Nothing is divided: inverse depths are compared after multiplication by depths. */

#include "frame.h"
#include "stencil.h"
#include "nearest.h"
#include "blocks.h"

/* What set the thresholds: docs/deviations.md, "Fragments cover what their pixel maps to", "Nothing is collected
   beside movers and nearer surfaces". */
#define SURFACE_STEP 0.02f /* relative step of inverse depth between neighbors of one surface ... */
#define SURFACE_CURVATURE 0.005f /* ... or relative deviation from the plane through them, where they are steeper */
#define MIXES_IN 0.9f /* times the depth of a fragment: the color of what is nearer may be mixed with its own */
#define REACH 2 /* px around a pixel that are looked at */

/* Depth of the pixels at an offset, NaN outside of the image. */
INLINE Floats depth_beside(const Span p, __global const float *depth, const int dx, const int dy) {
    const Floats z = beside(p, depth, dx, dy);
    return is_inside(p, dx, dy) ? z : (Floats)(NAN);
}

/* Whether the inverse depth of a plane, which is linear, goes on from a2 over a to b; multiplied by all three depths.
   `most`: the larger one of a and b. */
INLINE Ints is_plane(const Floats a2, const Floats a, const Floats b, const Floats most) {
    return (a2 > 0.0f) & (a2 < INFINITY) & (fabs((a2 - a) * b - (a - b) * a2) < SURFACE_CURVATURE * most * a2);
}

/* Links to the neighbors of the same surface, whose depth is near or, where it is steeper, goes on; if any of them
   `moves`, to those that are equally static or dynamic. */
INLINE Ints links_of(const Span p, __global const float *depth, __global const uchar *dynamic_mask, const bool moves) {
    const Floats z = depth_beside(p, depth, 0, 0);
    const Ints own = moves ? bytes_beside(p, dynamic_mask, 0, 0) : (Ints)(0);
    Ints links = 0;
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        const int dx = k == 0 ? 1 : k == 2 ? -1 : 0, dy = k == 1 ? 1 : k == 3 ? -1 : 0;
        const Floats b = depth_beside(p, depth, dx, dy), most = z > b ? z : b;
        const Ints steep = (z > 0.0f) & (b > 0.0f) & (most < INFINITY) & !(fabs(z - b) <= SURFACE_STEP * most);
        Ints linked = (z > 0.0f) & (b > 0.0f) & !steep & ((most < INFINITY) | (z == b));
        if (ANY(steep))
            linked |= steep
                      & (is_plane(depth_beside(p, depth, -dx, -dy), z, b, most)
                         | is_plane(depth_beside(p, depth, 2 * dx, 2 * dy), b, z, most));
        if (moves) linked &= bytes_beside(p, dynamic_mask, dx, dy) == own;
        links |= linked ? (Ints)(LINK_RIGHT << k) : (Ints)(0);
    }
    return links;
}

/* Links with those of lattices: pixels of a lattice are linked with each other, and with no others. `around`: which
   blocks are part of one (lattices.h), but for those in which something stirs. */
INLINE Ints with_lattices(const Ints links, const Span p, const uchar around, __constant Frame *frame,
                          __global const int *last_stir) {
    const int columns = block_columns(p.width), block = block_of(p.x, p.y, p.width);
    const int beside[5] = {block + 1, block + columns, block - 1, block - columns, block};
    int found = 0;
    for (int k = 0; k < 5; ++k)
        if (around >> k & 1 && calm_frames(beside[k], frame, last_stir) > 0) found |= LINK_RIGHT << k;
    /* links that stay: but for those across the border of a lattice */
    const int own = found & IN_LATTICE ? ALL_LINKS : 0, parts = (found ^ own) & ALL_LINKS;
    const Ints column = p.x % BLOCK_WIDTH + LANE_NUMBERS;
    const int row = p.y % BLOCK_HEIGHT, last = (row == BLOCK_HEIGHT - 1 ? LINK_DOWN : 0) | (row == 0 ? LINK_UP : 0);
    const Ints ends = (column == BLOCK_WIDTH - 1 ? (Ints)(LINK_RIGHT) : (Ints)(0))
                      | (column == 0 ? (Ints)(LINK_LEFT) : (Ints)(0)) | last;
    return own ? ~(ends & parts) & (IN_LATTICE | ALL_LINKS) : links & ~(ends & parts);
}

/* The background before collection: the state of all levels, and the receivers of fragments offered to them. */
typedef struct {
    __global uchar *levels_state;
    __global Key *keys;
    __global uint *winners;
} Collecting;

/* links: which of the four neighbors belong to the same surface and are equally static or dynamic. To `collect`:
   texels are SHOWN where depth is valid and none of 3x3 pixels is dynamic or nearer, and an EDGE where one is nearer,
   but none is dynamic. The others are EMPTY, and no fragment is offered to them yet. `around`: of with_lattices. */
INLINE void find(const Span p, __constant Frame *frame, __global const float *depth, __global const uchar *dynamic_mask,
                 __global const int *last_stir, const uchar around, __global uchar *links, const Collecting to) {
    const int i = p.y * p.width + p.x, count = min(LANES, p.width - p.x);
    const Floats z = depth_beside(p, depth, 0, 0);
    Floats nearest = z;
    Ints moving = 0;
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const Floats beside = depth_beside(p, depth, k % 3 - 1, k / 3 - 1);
        nearest = beside < nearest ? beside : nearest;
        moving |= bytes_beside(p, dynamic_mask, k % 3 - 1, k / 3 - 1);
    }
    Ints linked = links_of(p, depth, dynamic_mask, ANY(moving != 0));
    if (around) linked = with_lattices(linked, p, around, frame, last_stir);
    store_some_bytes(to_bytes(linked), count, links + i);
    if (!frame->levels || !frame->has_previous) return;
    const Ints settled = (z > 0.0f) & (moving == 0), clean = settled & !(nearest < z * MIXES_IN);
    const Ints state = clean ? (Ints)(SHOWN) : settled ? (Ints)(EDGE) : (Ints)(EMPTY);
    store_some_bytes(to_bytes(state), count, to.levels_state + i);
    if (ALL(settled)) return;
    for (int k = 0; k < count; ++k) forget(to.keys, to.winners, i + k);
}

WIDE __kernel void find_links(__constant Frame *restrict frame, __global const float *depth,
                              __global const uchar *dynamic_mask, __global const int *last_stir,
                              __global const uchar *lattices, __global uchar *links, __global uchar *levels_state,
                              __global Key *keys, __global uint *winners) {
    const int width = frame->source_width, height = frame->source_height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1);
    const Collecting to = {levels_state, keys, winners};
    if (x >= width || y >= height) return;
    const int block = block_of(x, y, width);
    if (links_are_known(block, frame, last_stir)) return;
    const uchar around = frame->lattices && frame->has_previous ? lattices[block] : 0;
    Span p = {x, y, width, height, false};
    if (x >= REACH && x + LANES + REACH <= width && y >= REACH && y + REACH < height) {
        p.inner = true;
        find(p, frame, depth, dynamic_mask, last_stir, around, links, to);
    } else {
        find(p, frame, depth, dynamic_mask, last_stir, around, links, to);
    }
}
