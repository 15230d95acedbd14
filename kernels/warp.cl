/* Warp (paper: 'Warping', with crack closing and resampling).
   A fragment covers, in the target image, the parallelogram to which its own pixel maps; the nearest fragment keeps a
   target pixel, ties go to the smallest source index. */

#include "common.h"
#include "cubic.h"
#include "nearest.h"

#define FOOTPRINT_HALF 0.65f     /* half a source pixel and a margin for second-order terms */
#define FOOTPRINT_REACH 8        /* px: the most that a fragment covers to each side */
#define STRETCH_MOST 4.0f        /* a footprint stretched more than this over what depth explains is not trusted */
#define SUBPIXEL_STEPS 256.0f
#define SAME_MOTION 0.5f         /* px: fragments that deviate less from the winner's motion are resampled with it */
#define MOVES_AWAY 1.0f          /* px: a nearer neighbour that deviates more uncovers what it was mixed with */
#define NEARER 0.97f

/* ---- where a source pixel goes ---------------------------------------------------------------------------- */

/* Target position as a linear function of the source position around one source pixel. */
typedef struct {
    float4 ddx, ddy;         /* change of (px, py, z) per source pixel to the right, down */
    float inv_xx, inv_xy, inv_yx, inv_yy;  /* inverse of the 2x2 part: source px per target px */
} Flow;

inline float4 slope(const int bits, const int forward, const int backward, const float4 here, const int src,
                    const int step, __global const float4 *target_position, bool *linked) {
    float4 sum = (float4)(0.0f);
    float count = 0.0f;
    if (bits & forward) {
        const float4 there = target_position[src + step];
        if (there.z > 0.0f) { sum += there - here; count += 1.0f; }
    }
    if (bits & backward) {
        const float4 there = target_position[src - step];
        if (there.z > 0.0f) { sum += here - there; count += 1.0f; }
    }
    *linked = count > 0.0f;
    if (isinf(here.z)) sum.z = 0.0f;
    return count == 2.0f ? sum * 0.5f : sum;
}

/* From the linked neighbours; along a direction without any, what depth alone explains. */
inline Flow flow_at(const int src, const int source_width, const float4 here, const float z_source,
                    __global const uchar *links,
                    __global const float4 *target_position, const float2 zoom) {
    const int bits = links[src];
    Flow flow;
    bool linked_x, linked_y;
    flow.ddx = slope(bits, LINK_RIGHT, LINK_LEFT, here, src, 1, target_position, &linked_x);
    flow.ddy = slope(bits, LINK_DOWN, LINK_UP, here, src, source_width, target_position, &linked_y);
    const float nearer = isinf(here.z) ? 1.0f : divide(z_source, here.z);
    const float scale_x = zoom.x * nearer, scale_y = zoom.y * nearer;
    const float most = STRETCH_MOST * fmax(scale_x, scale_y);
    if (!linked_x || fabs(flow.ddx.x) > most || fabs(flow.ddx.y) > most) flow.ddx = (float4)(scale_x, 0.0f, 0.0f, 0.0f);
    if (!linked_y || fabs(flow.ddy.x) > most || fabs(flow.ddy.y) > most) flow.ddy = (float4)(0.0f, scale_y, 0.0f, 0.0f);
    float det = flow.ddx.x * flow.ddy.y - flow.ddy.x * flow.ddx.y;
    if (!(det > 0.02f * scale_x * scale_y)) {  /* folded or edge-on: the neighbours say nothing about the footprint */
        flow.ddx = (float4)(scale_x, 0.0f, 0.0f, 0.0f);
        flow.ddy = (float4)(0.0f, scale_y, 0.0f, 0.0f);
        det = scale_x * scale_y;
    }
    flow.inv_xx = divide(flow.ddy.y, det);
    flow.inv_xy = divide(-flow.ddy.x, det);
    flow.inv_yx = divide(-flow.ddx.y, det);
    flow.inv_yy = divide(flow.ddx.x, det);
    return flow;
}

inline float2 source_offset(const Flow flow, const float2 d) {
    return (float2)(flow.inv_xx * d.x + flow.inv_xy * d.y, flow.inv_yx * d.x + flow.inv_yy * d.y);
}

/* ---- splat --------------------------------------------------------------------------------------------------- */

__kernel void splat(const int source_width, const int source_height, const int target_width, const int target_height,
                    const int crack_closing, const int pass, const float2 zoom,
                    __global const float *depth, __global const uchar *links, __global const float4 *target_position,
                    __global Key *keys, __global uint *winners) {
    const int src_x = get_global_id(0), src_y = get_global_id(1);
    if (src_x >= source_width || src_y >= source_height) return;
    const int src = src_y * source_width + src_x;
    const float4 here = target_position[src];
    const float reach = (float)FOOTPRINT_REACH;
    if (!(here.z > 0.0f && here.x > -reach && here.y > -reach && here.x < (float)target_width + reach
          && here.y < (float)target_height + reach)) return;
    const int own_x = (int)floor(here.x), own_y = (int)floor(here.y);
    if (inside(own_x, own_y, target_width, target_height))
        offer(pass, keys, winners, own_y * target_width + own_x, here.z, (uint)src);
    if (!crack_closing) return;

    const Flow flow = flow_at(src, source_width, here, depth[src], links, target_position, zoom);
    const float half_x = fmin(FOOTPRINT_HALF * (fabs(flow.ddx.x) + fabs(flow.ddy.x)), reach);
    const float half_y = fmin(FOOTPRINT_HALF * (fabs(flow.ddx.y) + fabs(flow.ddy.y)), reach);
    const int x0 = max((int)ceil(here.x - half_x - 0.5f), 0), x1 = min((int)floor(here.x + half_x - 0.5f),
                                                                       target_width - 1);
    const int y0 = max((int)ceil(here.y - half_y - 0.5f), 0), y1 = min((int)floor(here.y + half_y - 0.5f),
                                                                       target_height - 1);
    for (int dst_y = y0; dst_y <= y1; ++dst_y)
        for (int dst_x = x0; dst_x <= x1; ++dst_x) {
            if (dst_x == own_x && dst_y == own_y) continue;
            const float2 d = source_offset(flow, pixel_centre(dst_x, dst_y) - here.xy);
            if (fabs(d.x) <= FOOTPRINT_HALF && fabs(d.y) <= FOOTPRINT_HALF)
                offer(pass, keys, winners, dst_y * target_width + dst_x, here.z, (uint)src);
        }
}

/* ---- resample ------------------------------------------------------------------------------------------------ */

/* px by which the fragment at offset (dx, dy) from the winner deviates from the motion of the winner's surroundings. */
inline float deviation(const float4 there, const int dx, const int dy, const float4 here, const Flow flow) {
    if (!(there.z > 0.0f)) return INFINITY;
    const float ex = there.x - here.x - flow.ddx.x * (float)dx - flow.ddy.x * (float)dy;
    const float ey = there.y - here.y - flow.ddx.y * (float)dx - flow.ddy.y * (float)dy;
    return fmax(fabs(ex), fabs(ey));
}

/* A pixel beside a nearer surface that moves away holds a mixture of both colours: the step, in source pixels,
   to the neighbour that does not, if that one moves along. */
inline int2 step_off_silhouette(const int src_x, const int src_y, const int source_width, const int source_height,
                                const float4 here,
                                const Flow flow, __global const float *depth, __global const float4 *target_position) {
    const int src = src_y * source_width + src_x;
    int2 step = (int2)(0, 0);
    for (int k = 0; k < 4; ++k) {
        const int dx = k == 0 ? 1 : k == 2 ? -1 : 0, dy = k == 1 ? 1 : k == 3 ? -1 : 0;
        if (!inside(src_x + dx, src_y + dy, source_width, source_height)) continue;
        const int beside = src + dy * source_width + dx;
        if (depth[beside] < depth[src] * NEARER && deviation(target_position[beside], dx, dy, here, flow) > MOVES_AWAY)
            step -= (int2)(dx, dy);
    }
    if (!inside(src_x + step.x, src_y + step.y, source_width, source_height)) return (int2)(0, 0);
    const float4 there = target_position[src + step.y * source_width + step.x];
    return deviation(there, step.x, step.y, here, flow) <= SAME_MOTION ? step : (int2)(0, 0);
}

/* Colour at (src_x, src_y) + d. Cubic where the neighbourhood moves alike, which its four inner taps and its corners
   tell; else bilinear over those of the four taps that move alike. */
inline float3 resample(const int src_x, const int src_y, const float2 d, const int source_width, const int source_height,
                       const float4 here,
                       const Flow flow, __global const float4 *target_position, __global const half *color) {
    if (d.x == 0.0f && d.y == 0.0f) return load_color(color, src_y * source_width + src_x);
    const int ox = (int)floor(d.x), oy = (int)floor(d.y);
    const float u = d.x - (float)ox, v = d.y - (float)oy;
    int alike = 0;  /* bits 0 to 3: the inner taps; 4 to 7: the corners */
    for (int k = 0; k < 8; ++k) {
        const int dx = ox + (k < 4 ? (k & 1) : 3 * (k & 1) - 1), dy = oy + (k < 4 ? (k >> 1) : 3 * ((k >> 1) & 1) - 1);
        const bool tap_alike = inside(src_x + dx, src_y + dy, source_width, source_height)
            && deviation(target_position[(src_y + dy) * source_width + src_x + dx], dx, dy, here, flow) <= SAME_MOTION;
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

__kernel void resolve(const int source_width, const int source_height, const int target_width, const int target_height,
                      const float2 zoom, __global const Key *keys, __global const uint *winners,
                      __global const half *color, __global const float *depth, __global const uchar *dynamic_mask,
                      __global const uchar *links, __global const float4 *target_position,
                      __global half *out_color, __global float *out_depth, __global float2 *out_motion,
                      __global uchar *out_dynamic, __global uchar *disoccluded, __global uchar *filled_by,
                      __global uchar *mixed) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    const uint src = winner_of(keys, winners, dst);
    if (src == NOBODY) {
        store_color((float3)(0.0f), out_color, dst);
        out_depth[dst] = INFINITY;
        out_motion[dst] = (float2)(0.0f);
        out_dynamic[dst] = 0;
        disoccluded[dst] = 1;
        mixed[dst] = 0;
        filled_by[dst] = BY_NOTHING;
        return;
    }
    const int src_x = src % source_width, src_y = src / source_width;
    const float4 here = target_position[src];
    const Flow flow = flow_at(src, source_width, here, depth[src], links, target_position, zoom);
    const float2 centre = pixel_centre(dst_x, dst_y);
    const float2 exact = clamp(source_offset(flow, centre - here.xy), -1.0f, 1.0f);
    const float2 d = rint(exact * SUBPIXEL_STEPS) * (1.0f / SUBPIXEL_STEPS);
    const int2 step = step_off_silhouette(src_x, src_y, source_width, source_height, here, flow, depth, target_position);
    store_color(resample(src_x, src_y, d + convert_float2(step), source_width, source_height, here, flow,
                         target_position, color), out_color, dst);
    const float z = here.z + flow.ddx.z * d.x + flow.ddy.z * d.y;
    out_depth[dst] = z > 0.0f ? z : here.z;
    out_motion[dst] = pixel_centre(src_x, src_y) + d - centre;
    out_dynamic[dst] = dynamic_mask[src];
    disoccluded[dst] = 0;
    mixed[dst] = step.x != 0 || step.y != 0;
    filled_by[dst] = (int)floor(here.x) == dst_x && (int)floor(here.y) == dst_y ? BY_WARP : BY_CRACK_CLOSING;
}
