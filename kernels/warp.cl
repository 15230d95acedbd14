/* Warp (paper: 'Warping', with crack closing and resampling).
   A fragment covers, in the target image, the parallelogram to which its own pixel maps; the nearest fragment keeps a
   target pixel, ties go to the smallest source index. Blocks that show one smooth surface (blocks.cl) are neither splatted
   nor searched: their pixels find the fragment by the inverse of the block's flow. */

#include "common.h"
#include "wide.h"
#include "cubic.h"
#include "nearest.h"
#include "flow.h"
#include "blocks.h"

#define STILL 0.001f             /* px: less than this is rounding */
#define SAME_MOTION 0.5f         /* px: fragments that deviate less from the winner's motion are resampled with it */
#define MOVES_AWAY 1.0f          /* px: a nearer neighbour that deviates more uncovers what it was mixed with */
#define NEARER 0.97f
#define ALL_LINKS 15

/* ---- splat --------------------------------------------------------------------------------------------------- */

inline void splat_fragment(const int src_x, const int src_y, const int source_width, const int source_height,
                           const int target_width, const int target_height, const int crack_closing, const int pass,
                           const float2 zoom, __global const float *depth, __global const uchar *links,
                           __global const float *target_position, __global Key *keys, __global uint *winners) {
    const int src = src_y * source_width + src_x, plane = source_width * source_height;
    const float3 here = position_of(target_position, src, plane);
    if (!may_land(here, target_width, target_height)) return;
    const int own_x = (int)floor(here.x), own_y = (int)floor(here.y);
    if (inside(own_x, own_y, target_width, target_height))
        offer(pass, keys, winners, own_y * target_width + own_x, here.z, (uint)src);
    if (!crack_closing) return;

    const Flow flow = flow_at(src, source_width, plane, here, depth[src], links, target_position, zoom);
    const float2 half_size = footprint(flow) + 0.51f;  /* to pixel centres, and a little for rounding */
    const int x0 = max((int)ceil(here.x - half_size.x), 0), x1 = min((int)floor(here.x + half_size.x - 1.0f), target_width - 1);
    const int y0 = max((int)ceil(here.y - half_size.y), 0), y1 = min((int)floor(here.y + half_size.y - 1.0f), target_height - 1);
    const float limit = FOOTPRINT_HALF * flow.det;
    for (int dst_y = y0; dst_y <= y1; ++dst_y)
        for (int dst_x = x0; dst_x <= x1; ++dst_x) {
            if (dst_x == own_x && dst_y == own_y) continue;
            const float2 centre = pixel_centre(dst_x, dst_y);
            const float2 d = source_offset(flow, centre.x - here.x, centre.y - here.y);
            if (fabs(d.x) <= limit && fabs(d.y) <= limit)
                offer(pass, keys, winners, dst_y * target_width + dst_x, here.z, (uint)src);
        }
}

/* LANES fragments inside a surface that cover no more than the 3x3 pixels around their own; false where they are not. */
inline bool splat_inside(const int src_x, const int src_y, const int source_width, const int source_height,
                         const int target_width, const int target_height, const int pass, const float2 zoom,
                         __global const float *depth, __global const uchar *links, __global const float *target_position,
                         __global Key *keys, __global uint *winners) {
    const int src = src_y * source_width + src_x, plane = source_width * source_height;
    if (src_x + LANES > source_width || !ALL(to_ints(load_bytes(0, links + src)) == ALL_LINKS)) return false;
    __global const float *p = target_position + src, *q = p + plane, *r = q + plane;
    const Floats x = load_floats(0, p), y = load_floats(0, q), z = load_floats(0, r);
    const Floats xx = ((load_floats(0, p + 1) - x) + (x - load_floats(0, p - 1))) * 0.5f;
    const Floats xy = ((load_floats(0, q + 1) - y) + (y - load_floats(0, q - 1))) * 0.5f;
    const Floats yx = ((load_floats(0, p + source_width) - x) + (x - load_floats(0, p - source_width))) * 0.5f;
    const Floats yy = ((load_floats(0, q + source_width) - y) + (y - load_floats(0, q - source_width))) * 0.5f;
    const Ints lands = (z > 0.0f) & (load_floats(0, r + 1) > 0.0f) & (load_floats(0, r - 1) > 0.0f)
                       & (load_floats(0, r + source_width) > 0.0f) & (load_floats(0, r - source_width) > 0.0f);
    const Floats nearer = isinf(z) ? (Floats)(1.0f) : wide_divide(load_floats(0, depth + src), z);
    const Floats scale_x = zoom.x * nearer, scale_y = zoom.y * nearer;
    const Floats most = STRETCH_MOST * (scale_x > scale_y ? scale_x : scale_y);
    const Floats det = xx * yy - yx * xy, own_x = floor(x), own_y = floor(y);
    const Ints small = (fabs(xx) <= most) & (fabs(xy) <= most) & (fabs(yx) <= most) & (fabs(yy) <= most)
                       & (det > 0.02f * scale_x * scale_y) & (FOOTPRINT_HALF * (fabs(xx) + fabs(yx)) < 1.49f)
                       & (FOOTPRINT_HALF * (fabs(xy) + fabs(yy)) < 1.49f);
    const Ints within = (own_x >= 1.0f) & (own_y >= 1.0f) & (own_x < (float)(target_width - 1))
                        & (own_y < (float)(target_height - 1));
    if (!ALL(lands & small & within)) return false;

    const Floats limit = FOOTPRINT_HALF * det;
    Ints covers = (Ints)(16);  /* bit 3 (dy + 1) + dx + 1; its own pixel always */
    for (int k = 0; k < 9; ++k) {
        const Floats dx = (own_x + ((float)(k % 3) - 0.5f)) - x, dy = (own_y + ((float)(k / 3) - 0.5f)) - y;
        const Ints covered = (fabs(yy * dx - yx * dy) <= limit) & (fabs(xx * dy - xy * dx) <= limit);
        covers |= covered ? (Ints)(1 << k) : (Ints)(0);
    }
    int lane_covers[LANES], lane_dst[LANES];
    float lane_z[LANES];
    store_ints(covers, 0, lane_covers);
    store_ints(to_ints(own_y) * target_width + to_ints(own_x), 0, lane_dst);
    store_floats(z, 0, lane_z);
    for (int lane = 0; lane < LANES; ++lane)
        for (int left = lane_covers[lane]; left; left &= left - 1) {
            const int k = 31 - clz(left & -left), dy = (k * 11) >> 5, dx = k - 3 * dy;
            offer(pass, keys, winners, lane_dst[lane] + (dy - 1) * target_width + dx - 1, lane_z[lane], (uint)(src + lane));
        }
    return true;
}

/* Whether any of the target blocks x0, y0, x1, y1 is splatted. */
inline bool any_splatted(const int4 reached, const int target_width, __global const uchar *block_class) {
    for (int y = reached.y; y <= reached.w; ++y)
        for (int x = reached.x; x <= reached.z; ++x)
            if (block_class[y * blocks_along(target_width) + x] == SPLATTED) return true;
    return false;
}

/* LANES fragments per work-item; those that reach only blocks that are warped backward are left out. */
WIDE __kernel void splat(const int source_width, const int source_height, const int target_width, const int target_height,
                         const int blocks, const int crack_closing, const int pass, const float2 zoom,
                         __global const float *depth, __global const uchar *links, __global const float *target_position,
                         __global const int4 *reach, __global const uchar *block_class, __global Key *keys,
                         __global uint *winners) {
    const int src_x = get_global_id(0) * LANES, src_y = get_global_id(1);
    if (src_x >= source_width || src_y >= source_height) return;
    if (blocks && crack_closing
        && !any_splatted(reach[src_y / BLOCK * blocks_along(source_width) + src_x / BLOCK], target_width, block_class)) return;
    if (crack_closing && splat_inside(src_x, src_y, source_width, source_height, target_width, target_height, pass, zoom,
                                      depth, links, target_position, keys, winners)) return;
    for (int x = src_x; x < min(src_x + LANES, source_width); ++x)
        splat_fragment(x, src_y, source_width, source_height, target_width, target_height, crack_closing, pass, zoom, depth,
                       links, target_position, keys, winners);
}

/* ---- resample ------------------------------------------------------------------------------------------------ */

/* px by which the fragment at offset (dx, dy) from the winner deviates from the motion of the winner's surroundings. */
inline float deviation(const float3 there, const int dx, const int dy, const float3 here, const Flow flow) {
    if (!(there.z > 0.0f)) return INFINITY;
    const float ex = there.x - here.x - flow.ddx.x * (float)dx - flow.ddy.x * (float)dy;
    const float ey = there.y - here.y - flow.ddx.y * (float)dx - flow.ddy.y * (float)dy;
    return fmax(fabs(ex), fabs(ey));
}

/* A pixel beside a nearer surface that moves away holds a mixture of both colours: the step, in source pixels,
   to the neighbour that does not, if that one moves along. */
inline int2 step_off_silhouette(const int src_x, const int src_y, const int source_width, const int source_height,
                                const float3 here, const Flow flow, __global const float *depth,
                                __global const float *target_position) {
    const int src = src_y * source_width + src_x, plane = source_width * source_height;
    int2 step = (int2)(0, 0);
    for (int k = 0; k < 4; ++k) {
        const int dx = k == 0 ? 1 : k == 2 ? -1 : 0, dy = k == 1 ? 1 : k == 3 ? -1 : 0;
        if (!inside(src_x + dx, src_y + dy, source_width, source_height)) continue;
        const int beside = src + dy * source_width + dx;
        if (depth[beside] < depth[src] * NEARER
            && deviation(position_of(target_position, beside, plane), dx, dy, here, flow) > MOVES_AWAY)
            step -= (int2)(dx, dy);
    }
    if (!inside(src_x + step.x, src_y + step.y, source_width, source_height)) return (int2)(0, 0);
    const float3 there = position_of(target_position, src + step.y * source_width + step.x, plane);
    return deviation(there, step.x, step.y, here, flow) <= SAME_MOTION ? step : (int2)(0, 0);
}

/* Colour at (src_x, src_y) + d. Cubic where the neighbourhood moves alike, which its four inner taps and its corners
   tell; else bilinear over those of the four taps that move alike. */
inline float3 resample(const int src_x, const int src_y, const float2 d, const int source_width, const int source_height,
                       const float3 here, const Flow flow, __global const float *target_position,
                       __global const half *color) {
    if (d.x == 0.0f && d.y == 0.0f) return load_color(color, src_y * source_width + src_x);
    const int ox = (int)floor(d.x), oy = (int)floor(d.y);
    const float u = d.x - (float)ox, v = d.y - (float)oy;
    int alike = 0;  /* bits 0 to 3: the inner taps; 4 to 7: the corners */
    for (int k = 0; k < 8; ++k) {
        const int dx = ox + (k < 4 ? (k & 1) : 3 * (k & 1) - 1), dy = oy + (k < 4 ? (k >> 1) : 3 * ((k >> 1) & 1) - 1);
        const bool tap_alike = inside(src_x + dx, src_y + dy, source_width, source_height)
            && deviation(position_of(target_position, (src_y + dy) * source_width + src_x + dx, source_width * source_height),
                         dx, dy, here, flow) <= SAME_MOTION;
        alike |= (int)tap_alike << k;
    }
    if (alike == 0xFF) return cubic(src_x + ox - 1, src_y + oy - 1, u, v, source_width, (__global const uint2 *)color);
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        if (!((alike >> tap) & 1)) continue;
        const float weight = bilinear_weight(tap, u, v);
        sum += weight * load_color(color, (src_y + oy + (tap >> 1)) * source_width + src_x + ox + (tap & 1));
        weight_sum += weight;
    }
    if (!(weight_sum > 0.01f)) return load_color(color, src_y * source_width + src_x);
    return mean_of(sum, weight_sum);
}

/* What rounding moved, less than STILL, did not move. */
inline float2 without_rounding(const float2 d) {
    return (float2)(fabs(d.x) < STILL ? 0.0f : d.x, fabs(d.y) < STILL ? 0.0f : d.y);
}

/* One pixel from the fragment that won it. Its key is emptied if the background may fill it. */
inline void resolve_pixel(const int dst_x, const int dst_y, const int source_width, const int source_height,
                          const int target_width, const int unfilled_label, const float2 zoom, __global Key *keys,
                          __global uint *winners, __global const half *color, __global const float *depth,
                          __global const uchar *dynamic_mask, __global const uchar *links,
                          __global const float *target_position, __global half *out_color, __global float *out_depth,
                          __global float2 *out_motion, __global uchar *out_dynamic, __global uchar *disoccluded,
                          __global uchar *filled_by, __global uchar *mixed) {
    const int dst = dst_y * target_width + dst_x, plane = source_width * source_height;
    const uint src = winner_of(keys, winners, dst);
    if (src == NOBODY) {
        store_color((float3)(0.0f), out_color, dst);
        out_depth[dst] = INFINITY;
        out_motion[dst] = (float2)(0.0f);
        out_dynamic[dst] = 0;
        disoccluded[dst] = 1;
        mixed[dst] = 0;
        filled_by[dst] = unfilled_label;
        return;
    }
    const int src_x = src % source_width, src_y = src / source_width;
    const float3 here = position_of(target_position, src, plane);
    const Flow flow = flow_at(src, source_width, plane, here, depth[src], links, target_position, zoom);
    const float2 centre = pixel_centre(dst_x, dst_y);
    const float2 offset = source_offset(flow, centre.x - here.x, centre.y - here.y);
    const float2 exact = (float2)(divide(offset.x, flow.det), divide(offset.y, flow.det));
    const float2 d = without_rounding(clamp(exact, -1.0f, 1.0f));
    const int2 step = step_off_silhouette(src_x, src_y, source_width, source_height, here, flow, depth, target_position);
    store_color(resample(src_x, src_y, d + convert_float2(step), source_width, source_height, here, flow,
                         target_position, color), out_color, dst);
    const float z = here.z + flow.ddx.z * d.x + flow.ddy.z * d.y;
    const bool is_mixed = step.x != 0 || step.y != 0;
    out_depth[dst] = z > 0.0f ? z : here.z;
    out_motion[dst] = pixel_centre(src_x, src_y) + d - centre;
    out_dynamic[dst] = dynamic_mask[src];
    disoccluded[dst] = 0;
    mixed[dst] = is_mixed;
    filled_by[dst] = (int)floor(here.x) == dst_x && (int)floor(here.y) == dst_y ? BY_WARP : BY_CRACK_CLOSING;
    if (is_mixed) forget(keys, winners, dst);
}

/* Neighbourhoods of LANES fragments in one plane of positions. */
typedef struct { Floats here, left, right, up, down; } Around;

inline Around around(__global const float *plane, const int source_width, const Ints src, const int first, const bool is_run) {
    Around a;
    if (is_run) {
        __global const float *p = plane + first;
        a.here = load_floats(0, p);
        a.left = load_floats(0, p - 1);
        a.right = load_floats(0, p + 1);
        a.up = load_floats(0, p - source_width);
        a.down = load_floats(0, p + source_width);
    } else {
        a.here = gather_floats(plane, src);
        a.left = gather_floats(plane - 1, src);
        a.right = gather_floats(plane + 1, src);
        a.up = gather_floats(plane - source_width, src);
        a.down = gather_floats(plane + source_width, src);
    }
    return a;
}

/* LANES pixels of a block that shows one smooth surface, each from the fragment to whose pixel the block's flow leads. */
inline void resolve_backward(const int dst_x, const int dst_y, const int source_width, const int source_height,
                             const int target_width, const float8 source, __global const half *color,
                             __global const uchar *dynamic_mask, __global const float *target_position,
                             __global half *out_color, __global float *out_depth, __global float2 *out_motion,
                             __global uchar *out_dynamic, __global uchar *disoccluded, __global uchar *filled_by,
                             __global uchar *mixed) {
    const int dst = dst_y * target_width + dst_x, plane = source_width * source_height;
    const Floats centre_x = row_centres(dst_x);
    const float centre_y = (float)dst_y + 0.5f;
    const Floats from_middle_x = centre_x - (float)(dst_x / BLOCK * BLOCK + BLOCK / 2);
    const float from_middle_y = centre_y - (float)(dst_y / BLOCK * BLOCK + BLOCK / 2);
    const Floats src_x = floor(source.s0 + source.s2 * from_middle_x + source.s3 * from_middle_y);
    const Floats src_y = floor(source.s1 + source.s4 * from_middle_x + source.s5 * from_middle_y);
    const Ints src = to_ints(src_y) * source_width + to_ints(src_x);
    int lane_src[LANES];
    store_ints(src, 0, lane_src);
    const bool is_run = ALL(src == lane_src[0] + LANE_NUMBERS);

    const Around x = around(target_position, source_width, src, lane_src[0], is_run);
    const Around y = around(target_position + plane, source_width, src, lane_src[0], is_run);
    const Around z = around(target_position + 2 * plane, source_width, src, lane_src[0], is_run);
    const Floats xx = (x.right - x.left) * 0.5f, xy = (y.right - y.left) * 0.5f, xz = (z.right - z.left) * 0.5f;
    const Floats yx = (x.down - x.up) * 0.5f, yy = (y.down - y.up) * 0.5f, yz = (z.down - z.up) * 0.5f;
    const Floats inverse = 1.0f / (xx * yy - yx * xy), ex = centre_x - x.here, ey = centre_y - y.here;
    Floats dx = (yy * ex - yx * ey) * inverse, dy = (xx * ey - xy * ex) * inverse;
    dx = fabs(dx) < STILL ? (Floats)(0.0f) : dx;
    dy = fabs(dy) < STILL ? (Floats)(0.0f) : dy;

    const Floats out_z = z.here + xz * dx + yz * dy;
    store_floats(out_z > 0.0f ? out_z : z.here, 0, out_depth + dst);  /* sky: infinity, its differences are no numbers */
    store_xy((src_x + 0.5f) + dx - centre_x, (src_y + 0.5f) + dy - centre_y, out_motion + dst);
    const Bytes none = (Bytes)(0);
    store_bytes((Bytes)(dynamic_mask[lane_src[0]]), 0, out_dynamic + dst);
    store_bytes(none, 0, disoccluded + dst);
    store_bytes(none, 0, mixed + dst);
    store_bytes((Bytes)(BY_WARP), 0, filled_by + dst);

    const Floats fx = floor(dx), fy = floor(dy);
    int tap[LANES];
    float u[LANES], v[LANES];
    store_ints(src + to_ints(fy) * source_width + to_ints(fx), 0, tap);
    store_floats(dx - fx, 0, u);
    store_floats(dy - fy, 0, v);
    for (int k = 0; k < LANES; ++k) {
        const float3 rgb = u[k] == 0.0f && v[k] == 0.0f
            ? load_color(color, tap[k])
            : cubic(tap[k] % source_width - 1, tap[k] / source_width - 1, u[k], v[k], source_width, (__global const uint2 *)color);
        store_color(rgb, out_color, dst + k);
    }
}

/* LANES pixels per work-item. */
WIDE __kernel void resolve(const int source_width, const int source_height, const int target_width, const int target_height,
                           const int unfilled_label, const float2 zoom, __global const uchar *block_class,
                           __global const float8 *block_source, __global Key *keys, __global uint *winners,
                           __global const half *color, __global const float *depth, __global const uchar *dynamic_mask,
                           __global const uchar *links, __global const float *target_position, __global half *out_color,
                           __global float *out_depth, __global float2 *out_motion, __global uchar *out_dynamic,
                           __global uchar *disoccluded, __global uchar *filled_by, __global uchar *mixed) {
    const int dst_x = get_global_id(0) * LANES, dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int block = dst_y / BLOCK * blocks_along(target_width) + dst_x / BLOCK;
    if (block_class[block] == BACKWARD) {
        resolve_backward(dst_x, dst_y, source_width, source_height, target_width, block_source[block], color, dynamic_mask,
                         target_position, out_color, out_depth, out_motion, out_dynamic, disoccluded, filled_by, mixed);
        return;
    }
    for (int x = dst_x; x < min(dst_x + LANES, target_width); ++x)
        resolve_pixel(x, dst_y, source_width, source_height, target_width, unfilled_label, zoom, keys, winners, color, depth,
                      dynamic_mask, links, target_position, out_color, out_depth, out_motion, out_dynamic, disoccluded,
                      filled_by, mixed);
}
