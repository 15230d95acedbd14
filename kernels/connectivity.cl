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

/* A row of pixels and those to their left and right: depths, NaN outside of the image, and values of the mask. */
typedef struct {
    Floats left, z, right, nearest;
    Bytes left_mask, mask, right_mask, moving;
} Row;

INLINE Row row_beside(const Span p, __global const float *depth, __global const uchar *dynamic_mask, const int dy) {
    Row row = {.left = depth_beside(p, depth, -1, dy),
               .z = depth_beside(p, depth, 0, dy),
               .right = depth_beside(p, depth, 1, dy),
               .nearest = INFINITY,
               .left_mask = run_beside(p, dynamic_mask, -1, dy),
               .mask = run_beside(p, dynamic_mask, 0, dy),
               .right_mask = run_beside(p, dynamic_mask, 1, dy)};
    row.nearest = row.left < row.nearest ? row.left : row.nearest;
    row.nearest = row.z < row.nearest ? row.z : row.nearest;
    row.nearest = row.right < row.nearest ? row.right : row.nearest;
    row.moving = row.left_mask | row.mask | row.right_mask;
    return row;
}

/* Whether pixels at depth z, `row` below these, and those at depth b, (dx, dy) further, are of one surface, whose depth
   is near or, where it is steeper, goes on. `behind`: the depth on the other side of z. */
INLINE Ints are_linked(const Span p, __global const float *depth, const int row, const int dx, const int dy,
                       const Floats behind, const Floats z, const Floats b) {
    const Floats most = z > b ? z : b;
    const Ints finite = most < INFINITY;
    const Ints near = (z > 0.0f) & (((fabs(z - b) <= SURFACE_STEP * most) & finite) | (z == b));
    if (ALL(near)) return near;
    const Ints steep = (z > 0.0f) & (b > 0.0f) & finite & !near;
    if (!ANY(steep)) return near;
    const Floats beyond = depth_beside(p, depth, 2 * dx, row + 2 * dy);
    return near | (steep & (is_plane(behind, z, b, most) | is_plane(beyond, b, z, most)));
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

/* links, of a block's width and height of pixels: which of the four neighbors belong to the same surface and are
   equally static or dynamic. To `collect`: texels are SHOWN where depth is valid and none of 3x3 pixels is dynamic or
   nearer, and an EDGE where one is nearer, but none is dynamic. The others are EMPTY, and no fragment is offered to
   them yet. `around`: of with_lattices. A link is found once for both pixels, of rows that follow one another. */
INLINE void find(const Span block, __constant Frame *frame, __global const float *depth,
                 __global const uchar *dynamic_mask, __global const int *last_stir, const uchar around,
                 __global uchar *links, __global uchar *levels_state, __global Key *keys, __global uint *winners) {
    const int count = min(LANES, block.width - block.x), rows = min(BLOCK_HEIGHT, block.height - block.y);
    const bool collects = frame->levels && frame->has_previous;
    Row above = row_beside(block, depth, dynamic_mask, -1), row = row_beside(block, depth, dynamic_mask, 0);
    Ints up = 0;
#pragma unroll 1
    for (int y = 0; y < rows; ++y) {
        const Row below = row_beside(block, depth, dynamic_mask, y + 1);
        if (y == 0) up = are_linked(block, depth, 0, 0, -1, below.z, row.z, above.z);
        Ints down = are_linked(block, depth, y, 0, 1, above.z, row.z, below.z);
        Ints right = are_linked(block, depth, y, 1, 0, row.left, row.z, row.right);
        Ints left = are_linked(block, depth, y, -1, 0, row.right, row.z, row.left);
        const Bytes moving = above.moving | row.moving | below.moving;
        if (ANY_BYTE(moving)) {
            const Ints own = to_ints(row.mask);
            up &= to_ints(above.mask) == own;
            down &= to_ints(below.mask) == own;
            right &= to_ints(row.right_mask) == own;
            left &= to_ints(row.left_mask) == own;
        }
        Ints linked = (right ? (Ints)(LINK_RIGHT) : (Ints)(0)) | (down ? (Ints)(LINK_DOWN) : (Ints)(0))
                      | (left ? (Ints)(LINK_LEFT) : (Ints)(0)) | (up ? (Ints)(LINK_UP) : (Ints)(0));
        Span p = block;
        p.y += y;
        if (around) linked = with_lattices(linked, p, around, frame, last_stir);
        const int i = p.y * p.width + p.x;
        store_some_bytes(to_bytes(linked), count, links + i);
        if (collects) {
            Floats nearest = above.nearest < row.nearest ? above.nearest : row.nearest;
            nearest = below.nearest < nearest ? below.nearest : nearest;
            const Ints settled = (row.z > 0.0f) & (to_ints(moving) == 0),
                       clean = settled & !(nearest < row.z * MIXES_IN);
            const Ints state = clean ? (Ints)(SHOWN) : settled ? (Ints)(EDGE) : (Ints)(EMPTY);
            store_some_bytes(to_bytes(state), count, levels_state + i);
            for (int k = 0; !ALL(settled) && k < count; ++k) forget(keys, winners, i + k);
        }
        above = row;
        row = below;
        up = down;
    }
}

/* One work-item per LANES pixels of BLOCK_HEIGHT rows. */
WIDE __kernel void find_links(__constant Frame *restrict frame, __global const float *depth,
                              __global const uchar *dynamic_mask, __global const int *last_stir,
                              __global const uchar *lattices, __global uchar *links, __global uchar *levels_state,
                              __global Key *keys, __global uint *winners) {
    const int width = frame->source_width, height = frame->source_height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1) * BLOCK_HEIGHT;
    if (x >= width || y >= height) return;
    const int block = block_of(x, y, width);
    if (links_are_known(block, frame, last_stir)) return;
    const uchar around = frame->lattices && frame->has_previous ? lattices[block] : 0;
    Span p = {x, y, width, height, false};
    if (x >= REACH && x + LANES + REACH <= width && y >= REACH && y + BLOCK_HEIGHT + REACH <= height) {
        p.inner = true;
        find(p, frame, depth, dynamic_mask, last_stir, around, links, levels_state, keys, winners);
    } else {
        find(p, frame, depth, dynamic_mask, last_stir, around, links, levels_state, keys, winners);
    }
}
