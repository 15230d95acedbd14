/* Warp (paper: 'Warping', with crack closing and resampling). A fragment covers, in the target image, the
   parallelogram to which its own pixel maps; the nearest fragment keeps a target pixel, ties go to the smallest
   source index. Blocks that show one smooth surface (backward_blocks.cl) are neither splatted nor searched: their
   pixels find the fragment by the inverse of the block's flow. */

#include "frame.h"
#include "resampling.h"
#include "nearest.h"
#include "flow.h"
#include "blocks.h"
#include "lists.h"
#include "thresholds.h"

/* What set the thresholds: docs/deviations.md, "Color is resampled at its sub-pixel position", "No colors mixed with a
   silhouette that moves away". */
#define STILL 0.001f             /* px: less than this is rounding */
#define SAME_MOTION 0.5f         /* px: fragments that deviate less from the winner's motion are resampled with it */
#define MOVES_AWAY 1.0f          /* px: a nearer neighbor that deviates more uncovers the surface it was mixed with */

/* The nearest fragment of each target pixel so far: nearest.h. */
typedef struct {
    __global Key *keys;
    __global uint *winners;
} Winners;

/* The new frame. */
typedef struct {
    __global half *color;
    __global float *depth;
    __global float2 *motion;
    __global uchar *dynamic_mask, *disoccluded, *filled_by, *mixed;
} NewFrame;

/* ---- splat --------------------------------------------------------------------------------------------------- */

INLINE void splat_fragment(const Fragments from, const Winners to, const int src, const int crack_closing,
                           const int pass) {
    const float3 here = position_of(from.target_position, src, from.plane);
    const int width = from.target_width, height = from.target_height;
    if (!may_land(from, here)) return;
    const int own_x = (int)floor(here.x), own_y = (int)floor(here.y);
    if (inside(own_x, own_y, width, height)) offer(pass, to.keys, to.winners, own_y * width + own_x, here.z, (uint)src);
    if (!crack_closing) return;

    Flow flow;
    flow_at(from, src, &flow);
    const float2 half_size = footprint(flow) + 0.51f;  /* to pixel centers, and a little for rounding */
    const int x0 = max((int)ceil(here.x - half_size.x), 0),
              x1 = min((int)floor(here.x + half_size.x - 1.0f), width - 1);
    const int y0 = max((int)ceil(here.y - half_size.y), 0),
              y1 = min((int)floor(here.y + half_size.y - 1.0f), height - 1);
    const float limit = FOOTPRINT_HALF * flow.det;
    for (int dst_y = y0; dst_y <= y1; ++dst_y)
        for (int dst_x = x0; dst_x <= x1; ++dst_x) {
            if (dst_x == own_x && dst_y == own_y) continue;
            const float2 center = pixel_center(dst_x, dst_y);
            const float2 d = source_offset(flow, center.x - here.x, center.y - here.y);
            if (fabs(d.x) <= limit && fabs(d.y) <= limit)
                offer(pass, to.keys, to.winners, dst_y * width + dst_x, here.z, (uint)src);
        }
}

/* LANES fragments, one pixel within the image, of which most cover no more than the 3x3 pixels around their own;
   gives the lanes that are done. */
INLINE Ints splat_lanes(const Fragments from, const Winners to, const int src, const int pass) {
    Positions at;
    WideFlow f;
    load_positions_of_run(from, src, &at);
    wide_flow(at, to_ints(load_bytes(0, from.links + src)), load_floats(0, from.depth + src), from.zoom, &f);
    const Floats x = at.x.here, y = at.y.here, z = at.z.here, own_x = floor(x), own_y = floor(y);
    const Ints within = (z > 0.0f) & (own_x >= 1.0f) & (own_y >= 1.0f) & (own_x < (float)(from.target_width - 1))
                        & (own_y < (float)(from.target_height - 1))
                        & (FOOTPRINT_HALF * (fabs(f.xx) + fabs(f.yx)) < 1.49f)
                        & (FOOTPRINT_HALF * (fabs(f.xy) + fabs(f.yy)) < 1.49f);
    const Floats limit = FOOTPRINT_HALF * f.det;
    Ints covers = (Ints)(16);  /* bit 3 (dy + 1) + dx + 1; its own pixel always */
    Floats across_x[3], across_y[3], down_x[3], down_y[3];  /* of source_offset at the three columns and rows */
    for (int k = 0; k < 3; ++k) {
        const Floats dx = (own_x + ((float)k - 0.5f)) - x, dy = (own_y + ((float)k - 0.5f)) - y;
        across_x[k] = f.yy * dx;
        across_y[k] = f.xy * dx;
        down_x[k] = f.yx * dy;
        down_y[k] = f.xx * dy;
    }
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const Ints covered =
            (fabs(across_x[k % 3] - down_x[k / 3]) <= limit) & (fabs(down_y[k / 3] - across_y[k % 3]) <= limit);
        covers |= covered ? (Ints)(1 << k) : (Ints)(0);
    }
    int lane_covers[LANES], lane_dst[LANES];
    float lane_z[LANES];
    store_ints(within ? covers : (Ints)(0), 0, lane_covers);
    store_ints(to_ints(own_y) * from.target_width + to_ints(own_x), 0, lane_dst);
    store_floats(z, 0, lane_z);
    for (int lane = 0; lane < LANES; ++lane)
        for (int left = lane_covers[lane]; left; left &= left - 1) {
            const int k = 31 - clz(left & -left), dy = (k * 11) >> 5, dx = k - 3 * dy;
            offer(pass, to.keys, to.winners, lane_dst[lane] + (dy - 1) * from.target_width + dx - 1, lane_z[lane],
                  (uint)(src + lane));
        }
    return within;
}

/* Whether any of the target blocks x0, y0, x1, y1 is splatted. */
INLINE bool any_splatted(const int4 reached, const int target_width, __global const uchar *block_class) {
    for (int y = reached.y; y <= reached.w; ++y)
        for (int x = reached.x; x <= reached.z; ++x)
            if (block_class[y * block_columns(target_width) + x] == SPLATTED) return true;
    return false;
}

/* LANES fragments per work-item; those that reach only blocks that are warped backward are left out. Empties the list
   of open pixels. */
WIDE __kernel void splat(__constant Frame *restrict frame, const int pass, __global const float *depth,
                         __global const uchar *links, __global const float *target_position,
                         __global const short4 *reach, __global const uchar *block_class, __global Key *keys,
                         __global uint *winners, __global uint *open) {
    const int width = frame->source_width, height = frame->source_height;
    if (get_global_id(0) == 0 && get_global_id(1) == 0) open[0] = 0;
    const Fragments from = {.depth = depth,
                            .target_position = target_position,
                            .links = links,
                            .width = width,
                            .height = height,
                            .plane = width * height,
                            .target_width = frame->target_width,
                            .target_height = frame->target_height,
                            .zoom = frame->zoom};
    const Winners to = {keys, winners};
    const int src_x = get_global_id(0) * LANES, src_y = get_global_id(1), src = src_y * width + src_x;
    if (src_x >= width || src_y >= height) return;
    if (frame->blocks && frame->crack_closing
        && !any_splatted(convert_int4(reach[block_of(src_x, src_y, width)]), frame->target_width, block_class))
        return;
    Ints done = (Ints)(0);
    if (frame->crack_closing && src_x >= 1 && src_y >= 1 && src_x + LANES < width && src_y + 1 < height)
        done = splat_lanes(from, to, src, pass);
    if (ALL(done)) return;
    int lane_done[LANES];
    store_ints(done, 0, lane_done);
    for (int k = 0; k < min(LANES, width - src_x); ++k)
        if (!lane_done[k]) splat_fragment(from, to, src + k, frame->crack_closing, pass);
}

/* ---- resample ------------------------------------------------------------------------------------------------ */

/* px by which the fragment at offset (dx, dy) from the winner deviates from the motion of the winner's surroundings. */
INLINE float deviation(const float3 there, const int dx, const int dy, const float3 here, const Flow flow) {
    const float ex = there.x - here.x - flow.xx * (float)dx - flow.yx * (float)dy;
    const float ey = there.y - here.y - flow.xy * (float)dx - flow.yy * (float)dy;
    return fmax(fabs(ex), fabs(ey));
}

/* A pixel beside a nearer surface that moves away has a mixture of both colors. Returns the step, in source pixels,
   to the neighbor without it, if that one moves along. */
INLINE int2 step_off_silhouette(const Fragments f, const int src_x, const int src_y, const float3 here,
                                const Flow flow) {
    const int src = src_y * f.width + src_x;
    int2 step = (int2)(0, 0);
    for (int k = 0; k < 4; ++k) {
        const int dx = k == 0 ? 1 : k == 2 ? -1 : 0, dy = k == 1 ? 1 : k == 3 ? -1 : 0;
        if (!inside(src_x + dx, src_y + dy, f.width, f.height)) continue;
        const int beside = src + dy * f.width + dx;
        if (f.depth[beside] < f.depth[src] * NEARER
            && deviation(position_of(f.target_position, beside, f.plane), dx, dy, here, flow) > MOVES_AWAY)
            step -= (int2)(dx, dy);
    }
    if (!inside(src_x + step.x, src_y + step.y, f.width, f.height)) return (int2)(0, 0);
    const float3 there = position_of(f.target_position, src + step.y * f.width + step.x, f.plane);
    return deviation(there, step.x, step.y, here, flow) <= SAME_MOTION ? step : (int2)(0, 0);
}

/* Prepares a sample at (src_x, src_y) + d. Whether the neighborhood moves alike is judged by its four inner taps and
   its corners, or known of `smooth` blocks. */
INLINE void sample_at(const Fragments f, const int src_x, const int src_y, const float2 d, const float3 here,
                      const Flow flow, const bool smooth, Sample *s) {
    const int ox = (int)floor(d.x), oy = (int)floor(d.y);
    s->src = src_y * f.width + src_x;
    s->tap = s->src + oy * f.width + ox;
    s->u = d.x - (float)ox;
    s->v = d.y - (float)oy;
    s->alike = ALL_ALIKE;
    if (smooth || (d.x == 0.0f && d.y == 0.0f)) return;
    for (int k = 0; k < 8; ++k) {
        const int dx = ox + (k < 4 ? (k & 1) : 3 * (k & 1) - 1), dy = oy + (k < 4 ? (k >> 1) : 3 * ((k >> 1) & 1) - 1);
        const bool tap_alike =
            inside(src_x + dx, src_y + dy, f.width, f.height)
            && deviation(position_of(f.target_position, s->src + dy * f.width + dx, f.plane), dx, dy, here, flow)
                   <= SAME_MOTION;
        if (!tap_alike) s->alike &= ~(1 << k);
    }
}

/* Motion below STILL is rounding, and counts as none. */
INLINE float2 without_rounding(const float2 d) {
    return (float2)(fabs(d.x) < STILL ? 0.0f : d.x, fabs(d.y) < STILL ? 0.0f : d.y);
}

/* One pixel, but for its color, from the fragment `src` that won it, which may be known to lie in a `smooth` block.
   Returns its entry in the list of open pixels, or NOBODY; a hole has nothing to be resampled. Its key is emptied if
   the background may fill it. */
INLINE uint resolve_pixel(const Fragments from, const Rendered shown, const Winners winners, const NewFrame to,
                          const int dst_x, const int dst_y, const uint src, const bool smooth, const int unfilled_label,
                          Sample *sample) {
    const int dst = dst_y * from.target_width + dst_x;
    if (src == NOBODY) {
        store_color((float3)(0.0f), to.color, dst);
        to.depth[dst] = INFINITY;
        to.motion[dst] = (float2)(0.0f);
        to.dynamic_mask[dst] = 0;
        to.disoccluded[dst] = 1;
        to.mixed[dst] = 0;
        to.filled_by[dst] = unfilled_label;
        return (uint)dst;
    }
    const int src_x = src % from.width, src_y = src / from.width;
    const float3 here = position_of(from.target_position, src, from.plane);
    Flow flow;
    flow_at(from, src, &flow);
    const float2 center = pixel_center(dst_x, dst_y);
    const float2 offset = source_offset(flow, center.x - here.x, center.y - here.y);
    const float2 exact = (float2)(divide(offset.x, flow.det), divide(offset.y, flow.det));
    const float2 d = without_rounding(clamp(exact, -1.0f, 1.0f));
    const int2 step = smooth ? (int2)(0, 0) : step_off_silhouette(from, src_x, src_y, here, flow);
    sample_at(from, src_x, src_y, d + convert_float2(step), here, flow, smooth, sample);
    const float z = here.z + flow.xz * d.x + flow.yz * d.y;
    const bool is_mixed = step.x != 0 || step.y != 0;
    to.depth[dst] = z > 0.0f ? z : here.z;
    to.motion[dst] = pixel_center(src_x, src_y) + d - center;
    to.dynamic_mask[dst] = shown.dynamic_mask[src] != STATIC;
    to.disoccluded[dst] = 0;
    to.mixed[dst] = is_mixed;
    to.filled_by[dst] = (int)floor(here.x) == dst_x && (int)floor(here.y) == dst_y ? BY_WARP : BY_CRACK_CLOSING;
    if (is_mixed) forget(winners.keys, winners.winners, dst);
    return is_mixed ? (uint)dst | MIXED_FLAG : NOBODY;
}

#if LANES == 8
/* The flow of fragments within one smooth surface: nothing to check. */
INLINE void smooth_flow(const Positions at, WideFlow *flow) {
    const Cross x = at.x, y = at.y, z = at.z;
    WideFlow f;
    f.xx = ((x.right - x.here) + (x.here - x.left)) * 0.5f;
    f.xy = ((y.right - y.here) + (y.here - y.left)) * 0.5f;
    f.yx = ((x.down - x.here) + (x.here - x.up)) * 0.5f;
    f.yy = ((y.down - y.here) + (y.here - y.up)) * 0.5f;
    const Ints sky = isinf(z.here);
    f.xz = sky ? (Floats)(0.0f) : ((z.right - z.here) + (z.here - z.left)) * 0.5f;
    f.yz = sky ? (Floats)(0.0f) : ((z.down - z.here) + (z.here - z.up)) * 0.5f;
    f.det = f.xx * f.yy - f.yx * f.xy;
    *flow = f;
}

/* deviation of fragments at (dx, dy) from the winners; infinite or no number where they go nowhere. */
INLINE Floats wide_deviation(const Floats there_x, const Floats there_y, const Floats dx, const Floats dy,
                             const Floats here_x, const Floats here_y, const WideFlow f) {
    const Floats ex = fabs(there_x - here_x - f.xx * dx - f.yx * dy),
                 ey = fabs(there_y - here_y - f.xy * dx - f.yy * dy);
    return ex > ey ? ex : ey;
}

/* Gives which lanes have no neighbor from which step_off_silhouette steps off. */
INLINE Ints stays(const Positions at, const Cross depth, const WideFlow f) {
    const Cross x = at.x, y = at.y;
    const Floats near = depth.here * NEARER, one = (Floats)(1.0f), none = (Floats)(0.0f);
    const Ints nearer = (depth.left < near) | (depth.right < near) | (depth.up < near) | (depth.down < near);
    if (!ANY(nearer)) return !nearer;
    const Ints left_moves = wide_deviation(x.left, y.left, -one, none, x.here, y.here, f) > MOVES_AWAY,
               right_moves = wide_deviation(x.right, y.right, one, none, x.here, y.here, f) > MOVES_AWAY,
               up_moves = wide_deviation(x.up, y.up, none, -one, x.here, y.here, f) > MOVES_AWAY,
               down_moves = wide_deviation(x.down, y.down, none, one, x.here, y.here, f) > MOVES_AWAY;
    return !((depth.left < near) & left_moves) & !((depth.right < near) & right_moves) & !((depth.up < near) & up_moves)
           & !((depth.down < near) & down_moves);
}

/* Gives which taps around (ox, oy) from the winners move alike, in bits: see resample. */
INLINE Ints taps_alike(const Fragments from, const Positions at, const Ints src, const Floats ox, const Floats oy,
                       const WideFlow f) {
    Places base;
    find_places(src + to_ints(oy) * from.width + to_ints(ox), 2 * from.width + 2, from.plane, &base);
    Ints alike = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 8; ++k) {
        const int dx = k < 4 ? (k & 1) : 3 * (k & 1) - 1, dy = k < 4 ? (k >> 1) : 3 * ((k >> 1) & 1) - 1;
        __global const float *p = from.target_position + dy * from.width + dx, *q = p + from.plane;
        const Floats there_x = floats_at(p, base), there_y = floats_at(q, base);
        const Ints tap_alike =
            wide_deviation(there_x, there_y, ox + (float)dx, oy + (float)dy, at.x.here, at.y.here, f) <= SAME_MOTION;
        alike |= tap_alike ? (Ints)(1 << k) : (Ints)(0);
    }
    return alike;
}
#endif

INLINE void store_labels(const NewFrame to, const int dst, const Bytes dynamic_mask, const Ints own) {
    store_bytes(min(dynamic_mask, (Bytes)(DYNAMIC)), 0, to.dynamic_mask + dst);
    store_bytes((Bytes)(0), 0, to.disoccluded + dst);
    store_bytes((Bytes)(0), 0, to.mixed + dst);
    store_bytes(to_bytes(own ? (Ints)(BY_WARP) : (Ints)(BY_CRACK_CLOSING)), 0, to.filled_by + dst);
}

#if LANES == 8
/* The winners of LANES pixels, which lie two pixels within the image, for the lanes in `use`. `smooth`: those in blocks
   where nothing moves apart, `strict`: all are in such of one surface. */
typedef struct {
    Ints x, y, use, smooth;
    bool strict;
} WideWinners;

/* resolve_pixel of LANES pixels. Gives the lanes that are done: those in use that stay where they are at
   silhouettes. */
INLINE Ints resolve_lanes(const Fragments from, const Rendered shown, const NewFrame to, const WideWinners won,
                          const int dst_x, const int dst_y) {
    /* The fragments that won, and where they go. */
    const int dst = dst_y * from.target_width + dst_x;
    const Floats center_x = row_centers(dst_x);
    const float center_y = (float)dst_y + 0.5f;
    const Ints src = won.y * from.width + won.x;
    Places places;
    find_places(src, from.width + 1, from.plane, &places);

    Positions at;
    load_positions(from, places, &at);

    /* Their flow; those beside a silhouette that may step off it are left to `resolve_pixel`. */
    WideFlow f;
    Ints done = won.use;
    const bool all_smooth = ALL(won.smooth | !won.use);
    if (won.strict) {
        smooth_flow(at, &f);
    } else {
        Cross depth;
        load_cross(from.depth, from.width, places, &depth);
        wide_flow(at, to_ints(bytes_at(from.links, places)), depth.here, from.zoom, &f);
        if (!all_smooth) done &= won.smooth | stays(at, depth, f);
    }

    /* The place within each fragment that lands on the pixel's center. */
    const Floats ex = center_x - at.x.here, ey = center_y - at.y.here, z = at.z.here;
    Floats dx = clamp(wide_divide(f.yy * ex - f.yx * ey, f.det), -1.0f, 1.0f);
    Floats dy = clamp(wide_divide(f.xx * ey - f.xy * ex, f.det), -1.0f, 1.0f);
    dx = fabs(dx) < STILL ? (Floats)(0.0f) : dx;
    dy = fabs(dy) < STILL ? (Floats)(0.0f) : dy;

    /* The taps around that place. */
    Samples samples;
    samples_at(src, dx, dy, from.width, &samples);
    if (!all_smooth) samples.alike = won.smooth ? samples.alike : taps_alike(from, at, src, floor(dx), floor(dy), f);

    /* The pixel: depth, motion, labels, color. */
    const Floats out_z = z + f.xz * dx + f.yz * dy;
    store_floats(out_z > 0.0f ? out_z : z, 0, to.depth + dst);
    store_xy((to_floats(won.x) + 0.5f) + dx - center_x, (to_floats(won.y) + 0.5f) + dy - center_y, to.motion + dst);
    store_labels(to, dst, bytes_at(shown.dynamic_mask, places),
                 (floor(at.x.here) == center_x - 0.5f) & (floor(at.y.here) == center_y - 0.5f));
    resample_lanes(samples, done, from.width, shown, dst, to.color);
    return done;
}

#endif

/* The places where LANES pixels of a block come from, by the inverse of its flow: `source` is find_source's of
   backward_blocks.cl. */
INLINE Floats px_from_block(const float8 source, const int dst_x, const int dst_y, Floats *px_y) {
    const Floats from_x = row_centers(dst_x % BLOCK_WIDTH) - 0.5f * (float)BLOCK_WIDTH;
    const float from_y = (float)(dst_y % BLOCK_HEIGHT) + 0.5f - 0.5f * (float)BLOCK_HEIGHT;
    *px_y = source.s1 + source.s4 * from_x + source.s5 * from_y;
    return source.s0 + source.s2 * from_x + source.s3 * from_y;
}

/* The fragments at those places. */
INLINE void winners_of_block(const float8 source, const int dst_x, const int dst_y, const int width, const int height,
                             Ints *x, Ints *y) {
    Floats px_y;
    const Floats px_x = px_from_block(source, dst_x, dst_y, &px_y);
    *x = clamp(to_ints(floor(px_x)), (Ints)(2), (Ints)(width - 3));
    *y = clamp(to_ints(floor(px_y)), (Ints)(2), (Ints)(height - 3));
}

/* LANES pixels, but for their color, of a block in which that is exact. */
INLINE void resolve_affine(const Fragments from, const Rendered shown, const NewFrame to, const float8 source,
                           const int dst_x, const int dst_y, Samples *samples) {
    const int dst = dst_y * from.target_width + dst_x;
    Floats px_y;
    const Floats px_x = px_from_block(source, dst_x, dst_y, &px_y);
    const Ints src_x = clamp(to_ints(px_x), (Ints)(2), (Ints)(from.width - 3));
    const Ints src_y = clamp(to_ints(px_y), (Ints)(2), (Ints)(from.height - 3));
    const Floats src_center_x = to_floats(src_x) + 0.5f, src_center_y = to_floats(src_y) + 0.5f;
    Floats dx = px_x - src_center_x, dy = px_y - src_center_y;
    dx = fabs(dx) < STILL ? (Floats)(0.0f) : dx;
    dy = fabs(dy) < STILL ? (Floats)(0.0f) : dy;
    const Ints src = src_y * from.width + src_x;
    Places places;
    find_places(src, from.width + 1, from.plane, &places);

    Cross z;
    load_cross(from.target_position + 2 * from.plane, from.width, places, &z);
    Ints level_x = isinf(z.here), level_y = level_x;
    if (source.s7 == FLOW_RIGID) {
        const Ints bits = to_ints(bytes_at(from.links, places));
        level_x |= (bits & (LINK_LEFT | LINK_RIGHT)) != (LINK_LEFT | LINK_RIGHT);
        level_y |= (bits & (LINK_UP | LINK_DOWN)) != (LINK_UP | LINK_DOWN);
    }
    const Floats across = level_x ? (Floats)(0.0f) : (z.right - z.left) * 0.5f,
                 down = level_y ? (Floats)(0.0f) : (z.down - z.up) * 0.5f;
    const Floats out_z = z.here + across * dx + down * dy;
    store_floats(out_z > 0.0f ? out_z : z.here, 0, to.depth + dst);
    store_xy(src_center_x + dx - row_centers(dst_x), src_center_y + dy - ((float)dst_y + 0.5f), to.motion + dst);
    store_labels(to, dst, bytes_at(shown.dynamic_mask, places),
                 (fabs(source.s5 * dx - source.s3 * dy) * source.s6 <= 0.5f)
                     & (fabs(source.s2 * dy - source.s4 * dx) * source.s6 <= 0.5f));
    samples_at(src, dx, dy, from.width, samples);
}

/* Whether fragment `src` lies in a block where nothing moves apart, and all taps around it in the image: at its border
   blocks may only be RESTING. */
INLINE bool is_smooth(const uint src, const int width, const int height, __global const uchar *source_smooth) {
    if (src == NOBODY) return false;
    const int x = (int)src % width, y = (int)src / width, smooth = source_smooth[block_of(x, y, width)];
    return smooth && (smooth != RESTING || (x >= 2 && y >= 2 && x < width - 2 && y < height - 2));
}

/* LANES pixels of a COPIED block, as they are in the rendered frame. */
INLINE void copy_pixels(const Fragments from, const Rendered shown, const NewFrame to, const int pixel) {
#pragma unroll
    for (int part = 0; part < PARTS; ++part) {
        Texels c = load_texels(part, shown.color + 4 * pixel);
        VALID(c) = (float)0;
        store_texels(c, part, to.color + 4 * pixel);
    }
    store_floats(load_floats(0, from.depth + pixel), 0, to.depth + pixel);
    store_xy((Floats)(0.0f), (Floats)(0.0f), to.motion + pixel);
    store_labels(to, pixel, (Bytes)(STATIC), ALL_LANES);
}

/* LANES pixels per work-item. Lists those that are open: holes, and mixed ones. */
LISTS __kernel void resolve(__constant Frame *restrict frame, const int unfilled_label,
                            __global const uchar *block_class, __global const float8 *block_source,
                            __global const uchar *source_smooth, __global Key *keys, __global uint *winners,
                            __global const half *color, __global const half *codes, __global const float *depth,
                            __global const uchar *dynamic_mask, __global const uchar *links,
                            __global const float *target_position, __global half *out_color, __global float *out_depth,
                            __global float2 *out_motion, __global uchar *out_dynamic, __global uchar *disoccluded,
                            __global uchar *filled_by, __global uchar *mixed, __global uint *open) {
    const int width = frame->source_width, height = frame->source_height;
    const int target_width = frame->target_width, target_height = frame->target_height;
    const Fragments from = {.depth = depth,
                            .target_position = target_position,
                            .links = links,
                            .width = width,
                            .height = height,
                            .plane = width * height,
                            .target_width = target_width,
                            .target_height = target_height,
                            .zoom = frame->zoom};
    const Rendered shown = {
        .color = color, .codes = codes, .dynamic_mask = dynamic_mask, .code_offset = frame->code_offset};
    const Winners winning = {keys, winners};
    const NewFrame to = {.color = out_color,
                         .depth = out_depth,
                         .motion = out_motion,
                         .dynamic_mask = out_dynamic,
                         .disoccluded = disoccluded,
                         .filled_by = filled_by,
                         .mixed = mixed};
    const int dst_x = get_global_id(0) * LANES, dst_y = get_global_id(1), dst = dst_y * target_width + dst_x;
    const bool is_pixel = dst_x < target_width && dst_y < target_height;
    const int block = is_pixel ? block_of(dst_x, dst_y, target_width) : 0;
    const uchar class = block_class[block];
    const bool backward = class == BACKWARD;
    const float8 source = backward ? block_source[block] : (float8)(0.0f);
    const bool affine = backward && (source.s7 == FLOW_AFFINE || source.s7 == FLOW_RIGID);
#if LANES == 1
    __local uint shared[2];
    uint entry = NOBODY;
    if (is_pixel && class == COPIED) {
        copy_pixels(from, shown, to, dst);
    } else if (is_pixel) {
        Sample sample;
        if (affine) {
            resolve_affine(from, shown, to, source, dst_x, dst_y, &sample);
        } else {
            uint src = 0;
            if (backward) {
                int src_x, src_y;
                winners_of_block(source, dst_x, dst_y, width, height, &src_x, &src_y);
                src = (uint)(src_y * width + src_x);
            } else {
                src = winner_of(keys, winners, dst);
            }
            const bool smooth = backward || is_smooth(src, width, height, source_smooth);
            entry = resolve_pixel(from, shown, winning, to, dst_x, dst_y, src, smooth, unfilled_label, &sample);
        }
        if (entry >= MIXED_FLAG) store_color(resample(sample, width, shown), out_color, dst);
    }
    append_of_group(entry != NOBODY, entry, open, shared);
#else
    if (!is_pixel) return;
    if (class == COPIED) {
        copy_pixels(from, shown, to, dst);
        return;
    }
    if (affine) {
        Samples samples;
        resolve_affine(from, shown, to, source, dst_x, dst_y, &samples);
        resample_lanes(samples, LANE_NUMBERS >= 0, width, shown, dst, out_color);
        return;
    }
    Ints done = (Ints)(0);
    if (backward || dst_x + LANES <= target_width) {
        WideWinners won = {.use = ALL_LANES, .smooth = ALL_LANES, .strict = backward && source.s7 == FLOW_SMOOTH};
        if (backward) {
            winners_of_block(source, dst_x, dst_y, width, height, &won.x, &won.y);
        } else {
            const Uints src = load_winners(keys, winners, dst);
            wide_column_and_row(to_ints(src), width, &won.x, &won.y);
            won.use = (src != NOBODY) & (won.x >= 2) & (won.y >= 2) & (won.x < width - 2) & (won.y < height - 2);
            won.x = won.use ? won.x : (Ints)(2);
            won.y = won.use ? won.y : (Ints)(2);
            const Ints blocks = won.y / BLOCK_HEIGHT * block_columns(width) + won.x / BLOCK_WIDTH;
            const Ints smooth = to_ints(gather_bytes(source_smooth, blocks));
            won.smooth = smooth != 0;
            won.strict = ALL(won.use & (smooth == STRICT));
        }
        if (ANY(won.use)) done = resolve_lanes(from, shown, to, won, dst_x, dst_y);
    }
    if (ALL(done)) return;
    int lane_done[LANES];
    store_ints(done, 0, lane_done);
    for (int k = 0; k < min(LANES, target_width - dst_x); ++k) {
        if (lane_done[k]) continue;
        Sample sample;
        const uint src = winner_of(keys, winners, dst + k);
        const bool smooth = is_smooth(src, width, height, source_smooth);
        const uint entry =
            resolve_pixel(from, shown, winning, to, dst_x + k, dst_y, src, smooth, unfilled_label, &sample);
        if (entry >= MIXED_FLAG) store_color(resample(sample, width, shown), out_color, dst + k);
        if (entry != NOBODY) append(entry, open);
    }
#endif
}
