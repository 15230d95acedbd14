/* Position prediction (paper: 'Position estimation'): NP = P_0 + alpha (P_0 - P_1), or the polynomial of order m
   through P_0 ... P_m at their real times. Static fragments, LANES at once, are only reprojected; those fixed to the
   camera keep their place in view space, those it carries move on there; P_1 is where the fragment's motion points
   to in the frame before, at the depth met there. Where the frame before does not show a mover's fragment, which came
   into view, that depth is the one of a static fragment; at the border of the image it changes as it does for the
   mover's nearest fragment whose depth is known, or as the motion of its fragments shows. The trusted part of a mover's
   acceleration (acceleration.cl) is added to the linear prediction; what spins moves as its center does. */

#include "frame.h"
#include "simd.h"
#include "nearest.h"
#include "mover_grid.h"
#include "blocks.h"

/* What set the thresholds: docs/deviations.md, "Movers that come into view go on as they came". */
#define NOWHERE -1.0e9f  /* px: far off any image */
#define ENTERS_FROM 0.5f /* of the image's width: motion vectors from farther outside are not believed */
#define INWARD_STEP 4    /* px: between fragments that are looked at from the border inward ... */
#define INWARD_STEPS 60
#define ONE_MOVER 0.1f   /* relative change of depth between them, within which they are of one mover */
#define LEAST_SPREAD 2.0f /* px: standard deviation of fragments whose motion is believed half */
#define LEAST_BEFORE 0.25f /* of its depth: at least so far from the camera was what enters */

/* The rendered frame, and the known motion of its fragments; those from `velocity` on are of the movers' grid. */
typedef struct {
    __global const float *depth;
    __global const float2 *motion;
    __global const uchar *dynamic_mask;
    __global const float *met_depth;
    __global const float4 *history, *velocity;
    __global const uint2 *acceleration, *bend, *view_velocity;
    TOLD
} Tracked;

/* Displacement of a fragment at depth z by acceleration after alpha intervals, interpolated between the cells around
   whose mover it may belong to: neighboring fragments must not part where cells meet. */
INLINE float3 bent(const int src_x, const int src_y, const float z, const bool carried, const Frame *frame,
                   const Tracked f) {
    const int level_width = (frame->source_width + MOVER_CELL - 1) / MOVER_CELL;
    const int level_height = (frame->source_height + MOVER_CELL - 1) / MOVER_CELL;
    const float per_px = 1.0f / (float)MOVER_CELL, alpha = frame->alpha, later = divide(alpha + 2.0f, 3.0f);
    const float fx = ((float)src_x + 0.5f) * per_px - 0.5f, fy = ((float)src_y + 0.5f) * per_px - 0.5f;
    const int x0 = (int)floor(fx), y0 = (int)floor(fy);
    float3 sum = (float3)(0.0f);
    float weights = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int x = x0 + (tap & 1), y = y0 + (tap >> 1), i = y * level_width + x;
        if (!inside(x, y, level_width, level_height) || !is_of_cell(z, f.velocity[i].w)) continue;
        const float trust = trust_of(f.acceleration[i]);
        if (trust < 0.0f || !is_trust_known(f.bend[i]) || is_trusted(f.view_velocity[i]) != carried) continue;
        const float weight = bilinear_weight(tap, fx - (float)x0, fy - (float)y0);
        sum += weight * (trust * unpacked(f.acceleration[i]) + later * unpacked(f.bend[i]));
        weights += weight;
    }
    return weights > 0.0f ? (alpha * (alpha + 1.0f)) * mean_of(sum, weights) : sum;
}

/* The direction (x / z, y / z) in which a fragment was in the frame before, a, and from where it would have been at
   rest, S: b = a S.z - S.xy. With a translation T of the mover, T.xy - a T.z = b. */
INLINE float4 equation(const float2 px, const float2 shift, const float z, const Frame *frame) {
    const Pinhole inverse = frame->from_previous.source_inverse;
    const float2 a = (px + shift - inverse.zw) * inverse.xy;
    const float3 rested = move_to_target(unproject(px, z, frame->to_target.source_inverse), frame->to_previous);
    return (float4)(a, a * rested.z - rested.xy);
}

/* The depth in the frame before of a dynamic fragment that was at px_prev, where that frame does not show it; 0: so far
   out of the image that its motion is not believed. Inside, where something hid it, it is that of a static surface.
   Outside it is the fragment's own depth times the ratio that the nearest known fragment of its mover has, straight
   inward from that border; without any, that of the translation which the motion of the fragments met shows. */
INLINE float entering_depth(const int src_x, const int src_y, const float2 px_prev, const Frame *frame,
                            const Tracked f) {
    const int width = frame->source_width, height = frame->source_height, src = src_y * width + src_x;
    const float out_x = fmax(-px_prev.x, px_prev.x - (float)width), out_y = fmax(-px_prev.y, px_prev.y - (float)height);
    const float out = fmax(out_x, out_y), most = ENTERS_FROM * (float)width;
    if (!(out <= most) || isnan(out_x) || isnan(out_y)) return 0.0f;
    const int dx = out_x < out_y ? 0 : px_prev.x < 0.0f ? 1 : -1, dy = out_x < out_y ? (px_prev.y < 0.0f ? 1 : -1) : 0;
    const float z = f.depth[src];
    const float z_static = reproject(pixel_center(src_x, src_y), z, frame->to_previous).z;
    if (!(out > 0.0f)) return fmax(z_static, 0.0f);
    float4 sum = (float4)(0.0f);
    float aa = 0.0f, ab = 0.0f, count = 0.0f, z_before = z;
    int way = INWARD_STEP; /* inward, then back to the border */
#pragma unroll 1
    for (int k = 0;; ++k) {
        const int x = src_x + k * way * dx, y = src_y + k * way * dy, i = y * width + x;
        const bool is_inside = k <= INWARD_STEPS && inside(x, y, width, height) && f.dynamic_mask[i] == DYNAMIC;
        const float z_there = is_inside ? f.depth[i] : 0.0f;
        const float2 shift = is_inside ? f.motion[i] : (float2)(0.0f);
        if (!(fabs(z_there - z_before) <= ONE_MOVER * z_before
              && fabs(shift.x) + fabs(shift.y) <= 2.0f * (float)width)) {
            if (way < 0) break;
            way = -way;
            k = 0;
            z_before = z;
            continue;
        }
        if (f.met_depth[i] > 0.0f) return z * divide(f.met_depth[i], z_there);
        const float4 e = equation(pixel_center(x, y), shift, z_there, frame);
        sum += e;
        aa += e.x * e.x + e.y * e.y;
        ab += e.x * e.z + e.y * e.w;
        count += 1.0f;
        z_before = z_there;
    }
    if (!(count > 0.0f)) return fmax(z_static, 0.0f);
    const float share = divide(1.0f, count), least = LEAST_SPREAD * frame->from_previous.source_inverse.x;
    aa -= share * (sum.x * sum.x + sum.y * sum.y);
    ab -= share * (sum.x * sum.z + sum.y * sum.w);
    return fmax(z_static - divide(ab, aa + count * least * least), LEAST_BEFORE * z);
}

/* Predicts (px in the target image, view depth there) of one fragment; depth -1 where there is nothing to splat. */
INLINE float3 predicted_position(const int src_x, const int src_y, const Frame *frame, const Tracked f) {
    const int src = src_y * frame->source_width + src_x, plane = frame->source_width * frame->source_height;
    const float z = f.depth[src];
    const float3 nowhere = (float3)(NOWHERE, NOWHERE, -1.0f);
    if (INVALID_DEPTH(z)) return nowhere;
    if (!f.dynamic_mask[src]) {
        const float3 place = reproject(pixel_center(src_x, src_y), z, frame->to_target);
        return place.z > 0.0f ? place : nowhere;
    }
    const float3 p0 = unproject(pixel_center(src_x, src_y), z, frame->to_target.source_inverse);
    if (f.dynamic_mask[src] == FIXED_TO_CAMERA) return (float3)(project(p0, frame->to_target.target), z);
    const float2 px_prev = pixel_center(src_x, src_y) + f.motion[src];
    float met = f.met_depth[src];
    if (frame->entering && !(met > 0.0f)) met = entering_depth(src_x, src_y, px_prev, frame, f);
    int known = frame->order > 0 && met > 0.0f;
    while (known > 0 && known < frame->order && f.history[known * plane + src].w != 0.0f) ++known;
    const float4 a = frame->polynomial[0], b = frame->polynomial[1], c = frame->polynomial[2], d = frame->polynomial[3];
    const float weight[MAX_ORDER] = {
        /* some drivers fail on an index that is not a constant */
        known < 2    ? a.x
        : known == 2 ? a.y
        : known == 3 ? a.w
        : known == 4 ? b.z
                     : c.z,
        known == 2   ? a.z
        : known == 3 ? b.x
        : known == 4 ? b.w
                     : c.w,
        known == 3   ? b.y
        : known == 4 ? c.x
                     : d.x,
        known == 4 ? c.y : d.y,
        d.z,
    };
    TELL(f, KNOWN, known);
    float3 predicted = p0;
    if (known > 0) {
        const float3 p1_prev = unproject(px_prev, met, frame->from_previous.source_inverse);
        const int cell = mover_cell_of(src_x, src_y, frame->source_width);
        const bool of_cell = frame->bends && is_of_cell(z, f.velocity[cell].w);
        const bool carried = of_cell && is_trusted(f.view_velocity[cell]);  /* by the camera */
        const float3 p1 = carried ? p1_prev : move_to_target(p1_prev, frame->from_previous);
        const bool spins = of_cell && !is_trust_known(f.bend[cell]);
        TELL(f, CARRIED, carried);
        TELL(f, SPINS, spins);
        TELL(f, TRUST, of_cell && !spins ? trust_of(f.bend[cell]) : 0.0f);
        predicted += spins ? frame->alpha * unpacked(f.bend[cell]) : weight[0] * (p1 - p0);
        if (of_cell && !spins) predicted += bent(src_x, src_y, z, carried, frame, f);
        if (carried) {
            if (!(predicted.z > 0.0f)) return nowhere;
            return (float3)(project(predicted, frame->to_target.target), predicted.z);
        }
    }
    for (int k = 1; k < known; ++k) predicted += weight[k] * (f.history[k * plane + src].xyz - p0);
    const float3 target_pos = move_to_target(predicted, frame->to_target);
    if (!(target_pos.z > 0.0f)) return nowhere;
    return (float3)(project(target_pos, frame->to_target.target), target_pos.z);
}

/* Prepares the keys of all target pixels for the dilated warp's offers: those at the places of LANES source pixels, and
   a source image's width or height further, if the target is larger. */
INLINE void forget_targets(const int src_x, const int src_y, const Frame *frame, __global Key *keys,
                           __global uint *winners) {
    const int width = frame->target_width, count = min(LANES, frame->source_width - src_x);
    for (int y = src_y; y < frame->target_height; y += frame->source_height)
        for (int x = src_x; x < width; x += frame->source_width)
            for (int k = 0; k < min(count, width - x); ++k) forget(keys, winners, y * width + x + k);
}

/* Depths of LANES pixels: where their block moves as one layer (lattices.h), those of its plane. */
INLINE Floats depths_of_layer(const int src_x, const int src_y, const Frame *frame, __global const float *depth,
                              __global const uchar *links, __global const float4 *layer) {
    const int src = src_y * frame->source_width + src_x;
    if (!frame->lattices || !(links[src] & IN_LATTICE)) return load_floats(0, depth + src);
    const float4 p = layer[block_of(src_x, src_y, frame->source_width)];
    const Floats across = row_centers(src_x % BLOCK_WIDTH) - 0.5f * (float)BLOCK_WIDTH;
    const float down = (float)(src_y % BLOCK_HEIGHT) + 0.5f - 0.5f * (float)BLOCK_HEIGHT;
    return wide_divide((Floats)(1.0f), (p.x + p.z * down) + p.y * across);
}

/* Writes the new frame's block, too, as the first that works on it. target_position: planes of x, y and depth. `keys`
   and `winners` are the dilated warp's. */
WIDE __kernel void predict_positions(const Frame given, __global Frame *frame, __global const float *depth,
                                     __global const float2 *motion, __global const uchar *dynamic_mask,
                                     __global const float *met_depth, __global const float4 *history,
                                     __global const float4 *velocity, __global const uint2 *acceleration,
                                     __global const uint2 *bend, __global const uint2 *view_velocity,
                                     __global const uchar *links, __global const float4 *layer,
                                     __global float *target_position, __global Key *keys, __global uint *winners) {
    const Tracked fragments = {depth,    motion,       dynamic_mask, met_depth,    history,
                               velocity, acceleration, bend,         view_velocity};
    const int source_width = given.source_width, source_height = given.source_height;
    const int src_x = get_global_id(0) * LANES, src_y = get_global_id(1);
    if (src_y == source_height) { /* a row of its own: it takes many registers */
        if (src_x == 0) *frame = given;
        return;
    }
    if (src_x >= source_width || src_y >= source_height) return;
    if (given.dilates) forget_targets(src_x, src_y, &given, keys, winners);
    const int src = src_y * source_width + src_x, plane = source_width * source_height;
    const bool whole = src_x + LANES <= source_width;
    bool movers = false;
    if (whole) {
        const Floats z = depths_of_layer(src_x, src_y, &given, depth, links, layer);
        const Wide3 target = wide_reproject(row_centers(src_x), (Floats)((float)src_y + 0.5f), z, given.to_target);
        const Ints valid = (z > 0.0f) & (target.z > 0.0f);
        store_floats(valid ? target.x : (Floats)(NOWHERE), 0, target_position + src);
        store_floats(valid ? target.y : (Floats)(NOWHERE), 0, target_position + plane + src);
        store_floats(valid ? target.z : (Floats)(-1.0f), 0, target_position + 2 * plane + src);
        movers = ANY(to_ints(load_bytes(0, dynamic_mask + src)) != 0);
    }
    if (whole && !movers) return;
    for (int k = src; k < src + min(LANES, source_width - src_x); ++k) {
        if (whole && !dynamic_mask[k]) continue;
        const float3 place = predicted_position(src_x + k - src, src_y, &given, fragments);
        target_position[k] = place.x;
        target_position[plane + k] = place.y;
        target_position[2 * plane + k] = place.z;
    }
}
