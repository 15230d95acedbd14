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

/* Box of target pixels. */
typedef struct {
    float x0, y0, x1, y1;
} Box;

/* The reach of a source block; beyond the image its last pixels count again. */
INLINE Box reach_of(const Fragments f, const int x0, const int y0) {
    const Floats reach = (Floats)(FOOTPRINT_REACH), far_off = (Floats)(INFINITY);
    Floats low_x = far_off, low_y = far_off, high_x = -far_off, high_y = -far_off;
    for (int src_y = y0; src_y < min(y0 + BLOCK_HEIGHT, f.height); ++src_y)
        for (int src_x = x0; src_x < min(x0 + BLOCK_WIDTH, f.width); src_x += LANES) {
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
        box.x0 = fmin(box.x0, float_of(&low_x, k));
        box.y0 = fmin(box.y0, float_of(&low_y, k));
        box.x1 = fmax(box.x1, float_of(&high_x, k));
        box.y1 = fmax(box.y1, float_of(&high_y, k));
    }
    return box;
}

/* The largest deviation of one coordinate from a linear function of the block's pixels and MARGIN more to each side,
   which passes through their corners; beyond any limit where a fragment goes nowhere. center: its value at the block's
   center. along, down: its slopes per pixel. */
INLINE Floats deviation_from_linear(__global const float *p, const int row, float *center, float *along, float *down) {
    const int last_x = BLOCK_WIDTH - 1 + MARGIN, last_y = (BLOCK_HEIGHT - 1 + MARGIN) * row;
    const float a = p[-MARGIN * row - MARGIN], b = p[-MARGIN * row + last_x], c = p[last_y - MARGIN],
                d = p[last_y + last_x];
    *center = 0.25f * ((a + d) + (b + c));
    *along = ((b - a) + (d - c)) * (0.5f / (float)(BLOCK_WIDTH - 1 + 2 * MARGIN));
    *down = ((c - a) + (d - b)) * (0.5f / (float)(BLOCK_HEIGHT - 1 + 2 * MARGIN));
    Floats worst = (Floats)(0.0f);
    /* Eight lanes take twelve columns in two overlapping steps. */
    for (int x = -MARGIN; x <= BLOCK_WIDTH + MARGIN - LANES; x += LANES == 1 ? 1 : 2 * MARGIN) {
        const Floats across = *center + *along * (row_centers(x) - 0.5f * (float)BLOCK_WIDTH);
#pragma unroll
        for (int y = -MARGIN; y < BLOCK_HEIGHT + MARGIN; ++y) {
            const Floats linear = across + *down * ((float)y + 0.5f - 0.5f * (float)BLOCK_HEIGHT);
            worst = wide_greater(worst, fabs(load_floats(0, p + y * row + x) - linear));
        }
    }
    return worst;
}

/* Whether the block that begins at pixel (x0, y0), with MARGIN around it, leaves the image. */
INLINE bool leaves(const int x0, const int y0, const int width, const int height) {
    return x0 < MARGIN || y0 < MARGIN || x0 + BLOCK_WIDTH + MARGIN > width || y0 + BLOCK_HEIGHT + MARGIN > height;
}

/* Whether positions are linear over the block; if so, *box is its reach. */
INLINE bool is_smooth(const Fragments f, const int x0, const int y0, Box *box) {
    if (leaves(x0, y0, f.width, f.height)) return false;
    __global const float *p = f.target_position + y0 * f.width + x0;
    float x, y, xx, xy, yx, yy;
    const Floats off_x = deviation_from_linear(p, f.width, &x, &xx, &yx);
    if (!ALL(off_x <= LINEAR_MOST)) return false;
    const Floats off_y = deviation_from_linear(p + f.plane, f.width, &y, &xy, &yy);
    if (!ALL(off_y <= LINEAR_MOST)) return false;
    const float half_x = 0.5f * (float)(BLOCK_WIDTH - 1) * xx + 0.5f * (float)(BLOCK_HEIGHT - 1) * fabs(yx)
                         + LINEAR_MOST + fmax(FOOTPRINT_HALF * (xx + fabs(yx)), HALF_LEAST);
    const float half_y = 0.5f * (float)(BLOCK_WIDTH - 1) * fabs(xy) + 0.5f * (float)(BLOCK_HEIGHT - 1) * yy
                         + LINEAR_MOST + fmax(FOOTPRINT_HALF * (fabs(xy) + yy), HALF_LEAST);
    const Box reach = {x - half_x, y - half_y, x + half_x, y + half_y};
    *box = reach;
    return xx >= STRETCH_LOW * f.zoom.x && xx <= STRETCH_HIGH * f.zoom.x && fabs(yx) <= SHEAR_MOST * f.zoom.x
           && yy >= STRETCH_LOW * f.zoom.y && yy <= STRETCH_HIGH * f.zoom.y && fabs(xy) <= SHEAR_MOST * f.zoom.y;
}

/* One work-item per source block. smooth: RESTING, SMOOTH or 0. reach:
   the target blocks x0, y0, x1, y1 with pixel centers in its fragments' footprints, x1 < x0 if none. reached_by: for
   each target block the extent of the source blocks that reach it, as the largest of FAR_OFF - x, FAR_OFF - y, x + 1, y
   + 1; of blocks that are not smooth, everything. */
WIDE __kernel void find_reach(__constant Frame *restrict frame, __global const float *depth,
                              __global const uchar *links, __global const float *target_position,
                              __global const int *last_stir, __global uchar *smooth, __global short4 *reach,
                              __global int *reached_by) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int bx = get_global_id(0), by = get_global_id(1);
    const int columns = block_columns(frame->source_width), block = by * columns + bx;
    if (bx >= columns || by >= block_rows(frame->source_height)) return;
    if (stays_put(block, frame, last_stir)) {
        smooth[block] = RESTING;
        reach[block] = (short4)(bx, by, bx, by);
        return;
    }

    /* The block's reach in the new frame ... */
    const Fragments fragments = fragments_of(frame, depth, target_position, links);
    const int x0 = bx * BLOCK_WIDTH, y0 = by * BLOCK_HEIGHT;
    Box box;
    const bool linear = is_smooth(fragments, x0, y0, &box);
    if (!linear) box = reach_of(fragments, x0, y0);
    smooth[block] = linear ? SMOOTH : 0;
    const float first_x = ceil(box.x0 - (0.5f + ROUNDING)), first_y = ceil(box.y0 - (0.5f + ROUNDING));
    const float last_x = floor(box.x1 - (0.5f - ROUNDING)), last_y = floor(box.y1 - (0.5f - ROUNDING));
    int4 reached = (int4)(1, 1, 0, 0);
    if (last_x >= 0.0f && last_y >= 0.0f && first_x < (float)target_width && first_y < (float)target_height)
        reached = (int4)((int)fmax(first_x, 0.0f) / BLOCK_WIDTH, (int)fmax(first_y, 0.0f) / BLOCK_HEIGHT,
                         (int)fmin(last_x, (float)(target_width - 1)) / BLOCK_WIDTH,
                         (int)fmin(last_y, (float)(target_height - 1)) / BLOCK_HEIGHT);
    reach[block] = convert_short4(reached);

    /* ... is noted in the blocks that it meets. */
    const int extent[4] = {FAR_OFF - (linear ? bx : 0), FAR_OFF - (linear ? by : 0), linear ? bx + 1 : FAR_OFF,
                           linear ? by + 1 : FAR_OFF};
    for (int y = reached.y; y <= reached.w; ++y)
        for (int x = reached.x; x <= reached.z; ++x)
            for (int k = 0; k < 4; ++k) {
                __global int *most = reached_by + 4 * (y * block_columns(target_width) + x) + k;
                /* on CPUs a plain look costs less than an atomic, which most blocks then need not make */
                if (LANES > 1 && LOOKS && *most >= extent[k]) continue;
                atomic_max(most, extent[k]);
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
