/* Blocks: which parts of the new frame need no splatting (for 'Warping').

   A source block is smooth if predicted positions change linearly over it. Every source block marks the target blocks
   with pixels that its fragments' footprints cover. A target block is warped backward, by the inverse of the flow at
   its center, if all that reach it lie side by side and are smooth: then nothing in it hides or uncovers anything. */

#include "frame.h"
#include "simd.h"
#include "flow.h"
#include "blocks.h"
#include "nearest.h"

/* What set the thresholds: docs/deviations.md, "Blocks where nothing moves apart are warped backward". */
#define FAR_OFF 0x3FFFFFFF        /* more than any block's coordinate */
#define MARGIN 2                  /* px around a block that must be linear, too: the taps of cubic resampling */
#define COLUMNS_MOST 3            /* of source blocks that reach a target block which is warped backward */
#define ROWS_MOST 4
#define LINEAR_MOST 0.03125f /* px: by how much the positions of a smooth block deviate from linear */
#define SHEAR_MOST 0.25f /* of a smooth block, per source pixel and zoom ... */
#define STRETCH_LOW 0.5f /* ... and how it is stretched */
#define STRETCH_HIGH 2.0f
#define HALF_LEAST 0.5f /* px: a fragment always covers the pixel that it lands on */
#define ROUNDING 0.01f /* px: more than the footprint's rounding in warp.cl */

/* Work-items that find the reach of a source block: a team on GPUs, a column each. */
#define MEMBERS (BLOCK_WIDTH / LANES)
#define WAIT_FOR_MEMBERS()                                                                                             \
    if (MEMBERS > 1) barrier(CLK_LOCAL_MEM_FENCE)

/* Box of target pixels. */
typedef struct {
    float x0, y0, x1, y1;
} Box;

INLINE Box around_both(const Box a, const Box b) {
    const Box both = {fmin(a.x0, b.x0), fmin(a.y0, b.y0), fmax(a.x1, b.x1), fmax(a.y1, b.y1)};
    return both;
}

/* A coordinate over a block as a linear function through the corners of what surrounds it by MARGIN: its value at the
   block's center, and its slopes per pixel. */
typedef struct {
    float center, along, down;
} Linear;

/* What the members of a team share. */
typedef struct {
    Linear x, y;
    Box boxes[MEMBERS];
    int4 reached; /* target blocks */
    int may_be_smooth, curved; /* curved: positions are not linear */
} Shared;

/* The reach of `member`'s columns of a source block; beyond the image its last pixels count again. */
INLINE Box reach_of(const Fragments f, const int x0, const int y0, const int member) {
    const Floats reach = (Floats)(FOOTPRINT_REACH), far_off = (Floats)(INFINITY);
    const int src_x = x0 + member;
    Floats low_x = far_off, low_y = far_off, high_x = -far_off, high_y = -far_off;
    for (int src_y = y0; src_x < f.width && src_y < min(y0 + BLOCK_HEIGHT, f.height); ++src_y) {
        Places src;
        Positions at;
        WideFlow flow;
        find_places(src_y * f.width + min(src_x + LANE_NUMBERS, (Ints)(f.width - 1)), f.width, f.plane, &src);
        load_positions(f, src, &at);
        wide_flow(at, to_ints(bytes_at(f.links, src)), floats_at(f.depth, src), f.zoom, &flow);
        const Floats x = at.x.here, y = at.y.here;
        const Ints lands = (at.z.here > 0.0f) & (x > -reach) & (y > -reach) & (x < (float)f.target_width + reach)
                           & (y < (float)f.target_height + reach);
        const Floats wide = wide_lesser(FOOTPRINT_HALF * (fabs(flow.xx) + fabs(flow.yx)), reach);
        const Floats high = wide_lesser(FOOTPRINT_HALF * (fabs(flow.xy) + fabs(flow.yy)), reach);
        const Floats half_x = wide_greater(wide, (Floats)(HALF_LEAST)),
                     half_y = wide_greater(high, (Floats)(HALF_LEAST));
        low_x = wide_lesser(lands ? x - half_x : far_off, low_x);
        low_y = wide_lesser(lands ? y - half_y : far_off, low_y);
        high_x = wide_greater(high_x, lands ? x + half_x : -far_off);
        high_y = wide_greater(high_y, lands ? y + half_y : -far_off);
    }
    Box box = {INFINITY, INFINITY, -INFINITY, -INFINITY};
    for (int k = 0; k < LANES; ++k) {
        const Box lane = {float_of(&low_x, k), float_of(&low_y, k), float_of(&high_x, k), float_of(&high_y, k)};
        box = around_both(box, lane);
    }
    return box;
}

/* `p`: the coordinate at the block's first pixel. */
INLINE Linear linear_through(__global const float *p, const int row) {
    const int last_x = BLOCK_WIDTH - 1 + MARGIN, last_y = (BLOCK_HEIGHT - 1 + MARGIN) * row;
    const float a = p[-MARGIN * row - MARGIN], b = p[-MARGIN * row + last_x], c = p[last_y - MARGIN],
                d = p[last_y + last_x];
    const Linear l = {0.25f * ((a + d) + (b + c)), ((b - a) + (d - c)) * (0.5f / (float)(BLOCK_WIDTH - 1 + 2 * MARGIN)),
                      ((c - a) + (d - b)) * (0.5f / (float)(BLOCK_HEIGHT - 1 + 2 * MARGIN))};
    return l;
}

/* Whether a coordinate deviates from linear in `member`'s columns, or a fragment goes nowhere. */
INLINE bool is_curved(__global const float *p, const int row, const Linear l, const int member) {
    Floats worst = (Floats)(0.0f);
    /* Eight lanes take twelve columns in two overlapping steps. */
    for (int x = member - MARGIN; x <= BLOCK_WIDTH + MARGIN - LANES; x += LANES == 1 ? MEMBERS : 2 * MARGIN) {
        const Floats across = l.center + l.along * (row_centers(x) - 0.5f * (float)BLOCK_WIDTH);
#pragma unroll
        for (int y = -MARGIN; y < BLOCK_HEIGHT + MARGIN; ++y) {
            const Floats linear = across + l.down * ((float)y + 0.5f - 0.5f * (float)BLOCK_HEIGHT);
            worst = wide_greater(worst, fabs(load_floats(0, p + y * row + x) - linear));
        }
    }
    return !ALL(worst <= LINEAR_MOST);
}

/* Whether the block that begins at pixel (x0, y0), with MARGIN around it, leaves the image. */
INLINE bool leaves(const int x0, const int y0, const int width, const int height) {
    return x0 < MARGIN || y0 < MARGIN || x0 + BLOCK_WIDTH + MARGIN > width || y0 + BLOCK_HEIGHT + MARGIN > height;
}

/* Whether a block may be smooth, by the slopes between its corners: it is neither sheared nor stretched much. */
INLINE bool may_be_smooth(const Linear x, const Linear y, const float2 zoom) {
    return x.along >= STRETCH_LOW * zoom.x && x.along <= STRETCH_HIGH * zoom.x && fabs(x.down) <= SHEAR_MOST * zoom.x
           && y.down >= STRETCH_LOW * zoom.y && y.down <= STRETCH_HIGH * zoom.y && fabs(y.along) <= SHEAR_MOST * zoom.y;
}

/* The reach of such a block. */
INLINE Box reach_of_smooth(const Linear x, const Linear y) {
    const float half_x = 0.5f * (float)(BLOCK_WIDTH - 1) * x.along + 0.5f * (float)(BLOCK_HEIGHT - 1) * fabs(x.down)
                         + LINEAR_MOST + fmax(FOOTPRINT_HALF * (x.along + fabs(x.down)), HALF_LEAST);
    const float half_y = 0.5f * (float)(BLOCK_WIDTH - 1) * fabs(y.along) + 0.5f * (float)(BLOCK_HEIGHT - 1) * y.down
                         + LINEAR_MOST + fmax(FOOTPRINT_HALF * (fabs(y.along) + y.down), HALF_LEAST);
    const Box reach = {x.center - half_x, y.center - half_y, x.center + half_x, y.center + half_y};
    return reach;
}

/* The target blocks x0, y0, x1, y1 with pixel centers in a box; x1 < x0 if there are none. */
INLINE int4 blocks_in(const Box box, const int target_width, const int target_height) {
    const float first_x = ceil(box.x0 - (0.5f + ROUNDING)), first_y = ceil(box.y0 - (0.5f + ROUNDING));
    const float last_x = floor(box.x1 - (0.5f - ROUNDING)), last_y = floor(box.y1 - (0.5f - ROUNDING));
    if (!(last_x >= 0.0f && last_y >= 0.0f && first_x < (float)target_width && first_y < (float)target_height))
        return (int4)(1, 1, 0, 0);
    return (int4)((int)fmax(first_x, 0.0f) / BLOCK_WIDTH, (int)fmax(first_y, 0.0f) / BLOCK_HEIGHT,
                  (int)fmin(last_x, (float)(target_width - 1)) / BLOCK_WIDTH,
                  (int)fmin(last_y, (float)(target_height - 1)) / BLOCK_HEIGHT);
}

/* A team per source block. smooth: RESTING, SMOOTH or 0. reach: the target blocks x0, y0, x1, y1 with pixel centers in
   its fragments' footprints, x1 < x0 if none. reached_by: for each target block the extent of the source blocks that
   reach it, as the largest of FAR_OFF - x, FAR_OFF - y, x + 1, y + 1; of blocks that are not smooth, everything. */
LISTS __kernel void find_reach(__constant Frame *restrict frame, __global const float *depth,
                               __global const uchar *links, __global const float *target_position,
                               __global const int *last_stir, __global uchar *smooth, __global short4 *reach,
                               __global int *reached_by) {
    const int width = frame->source_width, height = frame->source_height;
    const int x = get_global_id(0) * LANES, member = MEMBERS == 1 ? 0 : x % BLOCK_WIDTH, bx = x / BLOCK_WIDTH,
              by = get_global_id(1);
    const int x0 = bx * BLOCK_WIDTH, y0 = by * BLOCK_HEIGHT, block = by * block_columns(width) + bx;
    const bool is_block = x0 < width && y0 < height;
#if LANES == 1
    __local Shared teams[2][8];
    __local Shared *team = &teams[get_local_id(0) / BLOCK_WIDTH][get_local_id(1)];
#else
    if (!is_block) return;
    Shared own, *team = &own;
#endif
    const Fragments fragments = fragments_of(frame, depth, target_position, links);
    __global const float *to_x = target_position + y0 * width + x0, *to_y = to_x + fragments.plane;
    const bool stays = is_block && stays_put(block, frame, last_stir), moves = is_block && !stays,
               is_inner = moves && !leaves(x0, y0, width, height);
    if (member == 0) {
        team->curved = 0;
        team->reached = (int4)(1, 1, 0, 0);
        if (is_inner) team->x = linear_through(to_x, width);
        if (is_inner) team->y = linear_through(to_y, width);
        team->may_be_smooth = is_inner && may_be_smooth(team->x, team->y, frame->zoom);
    }
    WAIT_FOR_MEMBERS();
    if (team->may_be_smooth && (is_curved(to_x, width, team->x, member) || is_curved(to_y, width, team->y, member)))
        team->curved = 1;
    WAIT_FOR_MEMBERS();
    const bool linear = team->may_be_smooth && !team->curved;
    if (moves && !linear) team->boxes[member] = reach_of(fragments, x0, y0, member);
    WAIT_FOR_MEMBERS();
    if (stays && member == 0) {
        smooth[block] = RESTING;
        reach[block] = (short4)(bx, by, bx, by);
    } else if (moves && member == 0) {
        Box box = linear ? reach_of_smooth(team->x, team->y) : team->boxes[0];
        for (int k = 1; !linear && k < MEMBERS; ++k) box = around_both(box, team->boxes[k]);
        smooth[block] = linear ? SMOOTH : 0;
        team->reached = blocks_in(box, frame->target_width, frame->target_height);
        reach[block] = convert_short4(team->reached);
    }
    WAIT_FOR_MEMBERS();

    /* The reach is noted in the blocks that it meets. */
    const int4 reached = team->reached;
    for (int y = reached.y; y <= reached.w; ++y)
        for (int i = 4 * reached.x + member; i < 4 * (reached.z + 1); i += MEMBERS) {
            __global int *most = reached_by + 4 * y * block_columns(frame->target_width) + i;
            const int at = i & 1 ? by : bx, extent = i & 2 ? (linear ? at + 1 : FAR_OFF) : FAR_OFF - (linear ? at : 0);
            /* on CPUs a plain look costs less than an atomic, which most blocks then need not make */
            if (LANES > 1 && LOOKS && *most >= extent) continue;
            atomic_max(most, extent);
        }
}

/* Finds where the center of a target block comes from, by Newton's method from the middle of the source blocks that
   reach it: (source px, slopes of the inverse xx, xy, yx, yy, determinant of the flow, 0); false if that leads
   elsewhere. */
INLINE bool find_source(const float2 center, const int4 extent, const int source_width, const int plane,
                        __global const float *target_position, float8 *source) {
    const int x0 = extent.x * BLOCK_WIDTH, y0 = extent.y * BLOCK_HEIGHT, x1 = (extent.z + 1) * BLOCK_WIDTH - 1,
              y1 = (extent.w + 1) * BLOCK_HEIGHT - 1;
    float2 px = 0.5f * (float2)((float)(x0 + x1 + 1), (float)(y0 + y1 + 1));
    for (int k = 0; k < 4; ++k) {
        const int src_x = clamp((int)floor(px.x), x0, x1), src_y = clamp((int)floor(px.y), y0, y1);
        const int src = src_y * source_width + src_x;
        __global const float *p = target_position + src, *q = p + plane;
        const float xx = 0.5f * (p[1] - p[-1]), xy = 0.5f * (q[1] - q[-1]);
        const float yx = 0.5f * (p[source_width] - p[-source_width]), yy = 0.5f * (q[source_width] - q[-source_width]);
        const float det = xx * yy - yx * xy, inverse = divide(1.0f, det), dx = center.x - *p, dy = center.y - *q;
        const float2 step = (float2)((yy * dx - yx * dy) * inverse, (xx * dy - xy * dx) * inverse);
        px = pixel_center(src_x, src_y) + step;
        if (fabs(step.x) <= 0.51f && fabs(step.y) <= 0.51f) {
            *source = (float8)(px, yy * inverse, -yx * inverse, -xy * inverse, xx * inverse, det, 0.0f);
            return true;
        }
    }
    return false;
}

/* One work-item per target block: stores its class, and for backward warping the source of its center. Clears the
   block's reach for the next frame, and the keys of splatted blocks; marks no silhouette in it if that `softens`
   any. */
SPARSE __kernel void classify_blocks(__constant Frame *restrict frame, __global const float *target_position,
                                     __global const uchar *smooth, __global int *reached_by,
                                     __global uchar *block_class, __global float8 *block_source, __global uchar *marked,
                                     __global Key *keys, __global uint *winners) {
    const int source_width = frame->source_width, source_height = frame->source_height;
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int bx = get_global_id(0), by = get_global_id(1);
    const int source_blocks = block_columns(source_width), target_blocks = block_columns(target_width);
    if (bx >= target_blocks || by >= block_rows(target_height)) return;
    const int block = by * target_blocks + bx;
    if (frame->softens) marked[block] = 0;
    __global int *reached = reached_by + 4 * block;
    int4 extent = (int4)(FAR_OFF - reached[0], FAR_OFF - reached[1], reached[2] - 1, reached[3] - 1);
    if (frame->stays && smooth[block] == RESTING) { /* source and target have the same blocks */
        if (reached[2] == 0 && (bx + 1) * BLOCK_WIDTH <= target_width) {
            block_class[block] = COPIED;
            return;
        }
        extent = (int4)(min(extent.x, bx), min(extent.y, by), max(extent.z, bx), max(extent.w, by));
    }
    vstore4((int4)(0), block, reached_by);
    bool backward = (bx + 1) * BLOCK_WIDTH <= target_width && (by + 1) * BLOCK_HEIGHT <= target_height
                    && extent.x <= extent.z && extent.y <= extent.w && extent.z - extent.x < COLUMNS_MOST
                    && extent.w - extent.y < ROWS_MOST;
    for (int y = extent.y; backward && y <= extent.w; ++y)
        for (int x = extent.x; x <= extent.z; ++x) {
            const uchar of_source = smooth[y * source_blocks + x];
            backward =
                backward && of_source
                && !(of_source == RESTING && leaves(x * BLOCK_WIDTH, y * BLOCK_HEIGHT, source_width, source_height));
        }
    if (backward) {
        float8 source;
        const float2 center =
            (float2)((float)(bx * BLOCK_WIDTH + BLOCK_WIDTH / 2), (float)(by * BLOCK_HEIGHT + BLOCK_HEIGHT / 2));
        backward = find_source(center, extent, source_width, source_width * source_height, target_position, &source);
        if (backward) block_source[block] = source;
    }
    block_class[block] = backward ? BACKWARD : SPLATTED;
    if (backward) return;
    for (int dst_y = by * BLOCK_HEIGHT; dst_y < min((by + 1) * BLOCK_HEIGHT, target_height); ++dst_y)
        for (int dst_x = bx * BLOCK_WIDTH; dst_x < min((bx + 1) * BLOCK_WIDTH, target_width); ++dst_x)
            forget(keys, winners, dst_y * target_width + dst_x);
}
