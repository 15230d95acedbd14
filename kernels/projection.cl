/* Projection of what the rendered frame hides into the new one: remembered fragments of the background's levels
   (levels.h; paper: 'Hierarchical Background Collection') into pixels that the warp left open, and parts of movers that
   reappear (reappearing.h). First all are offered, and each pixel keeps the nearest; parts win over the background.
   Then these pixels are filled. */

#include "levels.h"
#include "nearest.h"
#include "lists.h"
#include "far_side.h"
#include "reappearing.h"

/* What set the threshold: docs/deviations.md, "Background texels cover what they map to". */
#define TEXEL_REACH 16.0f              /* px: the most that a texel covers to each side */
/* TEXEL_HALF: of a texel's side: of fragments that met in a texel one is left, so gaps reach two texels */
#define TEXEL_HALF 1.25f

/* The new frame as the warp leaves it, and whom fragments are offered to. */
typedef struct {
    int width, pixels, pass;
    __global const uchar *disoccluded;
    __global Key *keys;
    __global uint *winners;
} Uncovered;

/* Offers a fragment to the pixels from (x0, y0) to (x1, y1) that the warp left invalid. It gives way to parts that
   reappear. */
INLINE void offer_to_pixels(const int x0, const int y0, const int x1, const int y1, const float z, const uint texel,
                            const Uncovered to) {
    for (int dst_y = y0; dst_y <= y1; ++dst_y) {
        const int first = dst_y * to.width + x0, last = dst_y * to.width + x1;
        if (first + RUN <= to.pixels && last - first < RUN && run_is_zero(to.disoccluded + first)) continue;
        for (int dst = first; dst <= last; ++dst)
            if (to.disoccluded[dst]) offer_bits(to.pass, to.keys, to.winners, dst, as_uint(z) | GIVES_WAY, texel);
    }
}

/* Offers the fragment of a texel of the levels. */
INLINE void project_texel(const int texel, __constant Frame *frame, __global const float *levels_depth,
                          __global const int *levels_px, const Uncovered to) {
    const int4 starts = frame->level_starts;
    const int target_width = frame->target_width, target_height = frame->target_height;
    const float2 zoom = frame->zoom;
    const int level = level_of(texel, starts), in_level = texel - start_of(level, starts);
    const int width = level_side(frame->source_width, level);
    const Texels texels = {.px = levels_px, .level = level, .width = width};
    const float z_source = levels_depth[texel];
    const float2 px = px_of(texels, texel, in_level % width, in_level / width, false);
    const float3 there = reproject(px, z_source, frame->to_target);
    if (!(there.z > 0.0f && there.x > -TEXEL_REACH && there.y > -TEXEL_REACH
          && there.x < (float)target_width + TEXEL_REACH && there.y < (float)target_height + TEXEL_REACH))
        return;
    const float nearer = isinf(there.z) ? 1.0f : divide(z_source, there.z);
    const float side = TEXEL_HALF * (float)(1 << level) * nearer;
    const float half_x = fmin(fmax(side * zoom.x, 0.5f), TEXEL_REACH),
                half_y = fmin(fmax(side * zoom.y, 0.5f), TEXEL_REACH);
    offer_to_pixels(max((int)ceil(there.x - half_x - 0.5f), 0), max((int)ceil(there.y - half_y - 0.5f), 0),
                    min((int)floor(there.x + half_x - 0.5f), target_width - 1),
                    min((int)floor(there.y + half_y - 0.5f), target_height - 1), there.z, (uint)texel, to);
}

/* Offers the remembered fragments of all levels (texels between two levels are EMPTY) and, if any `reappear`, parts of
   movers, which are listed. */
SCAN_FLAT __kernel void
offer_hidden(__constant Frame *restrict frame, const int pass, const int reappear, __global const float *levels_depth,
             __global const int *levels_px, __global const uchar *levels_state, __global const uchar *disoccluded,
             __global const float *depth, __global const float2 *motion, __global const uchar *dynamic_mask,
             __global const uchar *links, __global const float *met_depth, __global const float *target_position,
             __global const float *depth_prev, __global const float *shown_depth, __global Key *keys,
             __global uint *winners, __global uchar *filled_by, __global uint *offered) {
    __local ushort found[SCAN_GROUP * SCAN_BYTES];
    __local uint count;
    const Uncovered to = {.width = frame->target_width,
                          .pixels = frame->target_width * frame->target_height,
                          .pass = pass,
                          .disoccluded = disoccluded,
                          .keys = keys,
                          .winners = winners};
    const Parts parts = {depth,        depth_prev, met_depth, target_position, shown_depth, motion,
                         dynamic_mask, links,      keys,      winners,         offered,     filled_by};
    const int first = scan_for(REMEMBERED, levels_state, frame->levels ? frame->level_starts.w : 0, found, &count);
    for (uint i = get_local_id(0); i < count; i += SCAN_GROUP)
        project_texel(first + found[i], frame, levels_depth, levels_px, to);
    barrier(CLK_LOCAL_MEM_FENCE);
    offer_at_edges(reappear, pass, frame, parts, found, &count);
}

/* ---- colors of the levels ----------------------------------------------------------------------------------- */

/* Code of the color of the 3x3 texels around a winner, weighted by their distance in the target image from `center`, of
   the winner's surface only. */
INLINE float3 color_around(const int winner, const int texel_x, const int texel_y, const int level_height,
                           const float z_winner, const float2 side, const float2 center, __constant Frame *frame,
                           const Texels texels) {
    const float inverse_x = divide(1.0f, side.x), inverse_y = divide(1.0f, side.y);
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int tap = 0; tap < 9; ++tap) {
        const int x = texel_x + tap % 3 - 1, y = texel_y + tap / 3 - 1;
        const int texel = winner + (tap / 3 - 1) * texels.width + tap % 3 - 1;
        if (!inside(x, y, texels.width, level_height)) continue;
        const bool shown = texels.state[texel] == SHOWN;
        if (!shown && texels.state[texel] != REMEMBERED) continue;
        const float z = depth_of(texels, texel, shown);
        if (!(z > 0.0f) || !is_same_surface(z, z_winner, 2.0f * SAME_LEVEL * z_winner)) continue;
        const float3 there = reproject(px_of(texels, texel, x, y, shown), z, frame->to_target);
        const float wx = 1.0f - fabs(there.x - center.x) * inverse_x, wy = 1.0f - fabs(there.y - center.y) * inverse_y;
        if (!(there.z > 0.0f && wx > 0.0f && wy > 0.0f)) continue;
        sum += wx * wy * code_of(texels, texel, shown, frame->code_offset);
        weight_sum += wx * wy;
    }
    return weight_sum > 0.01f ? mean_of(sum, weight_sum) : code_of(texels, winner, false, frame->code_offset);
}

/* The new frame. */
typedef struct {
    __global half *color;
    __global float *depth;
    __global float2 *motion;
    __global uchar *filled_by;
} NewFrame;

/* ---- parts that reappear ---------------------------------------------------------------------------------------- */

/* The rendered frame and the one before, and which of its movers' parts won pixels of the new one. */
typedef struct {
    __global const half *color_prev;
    __global const float *depth_prev;
    __global const float2 *source_motion;
    __global const float *target_position;
    __global const Key *keys;
    __global const uint *winners;
} Winning;

/* The part that won a pixel: its color and depth, and where it is in the rendered image, from the pixel's center. */
typedef struct {
    float3 rgb;
    float2 motion;
    float z;
} Part;

INLINE Part part_at(const int dst, __constant Frame *frame, const Winning f) {
    const int width = frame->source_width, dst_x = dst % frame->target_width, dst_y = dst / frame->target_width;
    const int src = (int)winner_of(f.keys, f.winners, dst);
    const float3 there = position_of(f.target_position, src, width * frame->source_height);
    const float2 place = place_of_part(src % width, src / width, dst_x, dst_y, there, frame);
    const float2 px_prev = place + f.source_motion[src];
    const Part part = {load_color(f.color_prev, (int)px_prev.y * width + (int)px_prev.x),
                       place - pixel_center(dst_x, dst_y), there.z};
    return part;
}

/* Code and depth of a pixel that was no hole: those of a part that reappears, which others may be writing now. */
INLINE float4 code_shown(const int dst, __constant Frame *frame, const Winning f, const NewFrame made) {
    if (made.filled_by[dst] != BY_REAPPEARING)
        return (float4)(load_code(made.color, dst, frame->code_offset), made.depth[dst]);
    const Part part = part_at(dst, frame, f);
    return (float4)(encode_color(part.rgb, frame->code_offset), part.z);
}

/* ---- colors beside ------------------------------------------------------------------------------------------ */

#define MIXED_REACH 16 /* px beyond which the far side does not represent the remembered surface */

#define FAR_COUNTS 0.5f /* px: weight of the far side per 1 / distance, a remembered color having 1 */
#define BEYOND_EDGE 4 /* px beyond the edge of a hole, where colors do not change with the mover's outline */
#define LEAST_CHANGE 0.001f /* squared change around, by which remembered colors count half; white is 1 */
#define CONTRAST_COUNTS 4.0f /* of the squared difference from colors around, times that by which it counts half */

/* What a hole of the background meets in direction k. */
INLINE Side look_beside(const int dst_x, const int dst_y, const int k, __constant Frame *frame,
                        __global const uchar *disoccluded, const Winning parts, const NewFrame made) {
    Side side = look(dst_x, dst_y, k, MIXED_REACH, frame, disoccluded, 1);
    if (side.meets) show(&side, code_shown(side.px, frame, parts, made));
    return side;
}

/* Code of the color of a static point in the frame before; false where that did not show its surface all around. */
INLINE bool shown_before(const float2 center, const float z, __constant Frame *frame, const Winning f, float3 *code) {
    const int width = frame->source_width, height = frame->source_height;
    const float3 px_prev = reproject(center, z, frame->target_to_previous);
    if (!(px_prev.z > 0.0f && px_prev.x >= 0.5f && px_prev.y >= 0.5f && px_prev.x < (float)width - 0.5f
          && px_prev.y < (float)height - 0.5f))
        return false;
    const int x0 = (int)(px_prev.x - 0.5f), y0 = (int)(px_prev.y - 0.5f);
    const float u = px_prev.x - 0.5f - (float)x0, v = px_prev.y - 0.5f - (float)y0;
    float3 sum = (float3)(0.0f);
    for (int tap = 0; tap < 4; ++tap) {
        const int i = (y0 + (tap >> 1)) * width + x0 + (tap & 1);
        if (!is_same_surface(f.depth_prev[i], px_prev.z, 2.0f * SAME_LEVEL * px_prev.z)) return false;
        sum += bilinear_weight(tap, u, v) * load_code(f.color_prev, i, frame->code_offset);
    }
    *code = sum;
    return true;
}

/* What is around a hole of the background, BEYOND_EDGE px beyond `side` in direction k: its code in the frame before,
   and the squared change since then, or -1 where that frame did not show it. */
INLINE float4 change_around(const int k, __local const Side *side, __constant Frame *frame,
                            __global const uchar *disoccluded, const Winning parts, const NewFrame made) {
    const float4 unknown = (float4)(0.0f, 0.0f, 0.0f, -1.0f);
    const int width = frame->target_width;
    const int2 d = BEYOND_EDGE * direction(k);
    const int dst_x = side->px % width + d.x, dst_y = side->px / width + d.y, dst = dst_y * width + dst_x;
    if (!side->meets || !inside(dst_x, dst_y, width, frame->target_height) || disoccluded[dst]) return unknown;
    const float4 shown = code_shown(dst, frame, parts, made);
    float3 code;
    if (!is_as_far(inverse_of(shown.w), side->inverse)
        || !shown_before(pixel_center(dst_x, dst_y), shown.w, frame, parts, &code))
        return unknown;
    const float3 change = shown.xyz - code;
    return (float4)(code, squared_length(change));
}

/* How far a remembered color is out of date, 0 to 1: as colors around have changed since the frame before, unless it
   differed more from them there. */
INLINE float staleness(const float3 remembered, __local const float4 *changes, const int far, const float offset) {
    float4 sum = (float4)(0.0f);
    float known = 0.0f;
    for (int k = 0; k < DIRECTIONS; ++k) {
        if (!has(far, k) || changes[k].w < 0.0f) continue;
        sum += changes[k];
        known += 1.0f;
    }
    if (!(known > 0.0f)) return 0.0f;
    const float white = display_white(offset), change = divide(sum.w, known);
    const float contrast = squared_length(remembered - mean_of(sum.xyz, known));
    return divide(change, change + CONTRAST_COUNTS * contrast + 3.0f * LEAST_CHANGE * white * white);
}

/* Mixes a fill of the background with the far side. A surface's remembered color may be out of date, so the weighted
   mean with the present color beside it is shown; that counts more the closer it is. */
INLINE void mix_far_side(const int dst, __local const Side *sides, __local const float4 *changes,
                         __constant Frame *frame, __global half *color) {
    const int far = far_side(sides);
    if (!far) return;
    const float3 mean = weighted_mean(sides, far, false, frame->code_offset).xyz;
    float counts = 0.0f;
    for (int k = 0; k < DIRECTIONS; ++k) counts = fmax(counts, has(far, k) ? FAR_COUNTS * sides[k].closeness : 0.0f);
    const float3 remembered = load_code(color, dst, frame->code_offset);
    const float stale = staleness(remembered, changes, far, frame->code_offset);
    const float3 sum = (1.0f - stale) * remembered + (stale + counts) * encode_color(mean, frame->code_offset);
    store_code(mean_of(sum, 1.0f + counts), color, dst, frame->code_offset);
}

/* Fills an open pixel that a remembered fragment won, unless it is a mover's. `texels`: of all levels. Returns whether
   it is filled. */
INLINE bool fill_pixel(const int dst, Texels texels, __constant Frame *frame, const Winning won, const NewFrame to) {
    const int dst_x = dst % frame->target_width, dst_y = dst / frame->target_width;
    const uint winner = winner_of(won.keys, won.winners, dst);
    if (winner == NOBODY || IS_OF_MOVER(to.filled_by[dst])) return false; /* its key may be a reappearing part's */
    const int4 starts = frame->level_starts;
    const int level = level_of(winner, starts), in_level = (int)winner - start_of(level, starts);
    texels.level = level;
    texels.width = level_side(frame->source_width, level);
    const int texel_x = in_level % texels.width, texel_y = in_level / texels.width;
    const float z_winner = texels.depth[winner];
    const float2 center = pixel_center(dst_x, dst_y);
    const float z = reproject(px_of(texels, winner, texel_x, texel_y, false), z_winner, frame->to_target).z;
    const float3 px_source = reproject(center, z, frame->to_source);
    if (!lands(px_source, frame->source_width, frame->source_height)) return false; /* only the footprint reaches it */
    const float side = (float)(1 << level) * (isinf(z) ? 1.0f : divide(z_winner, z));
    const float3 code = color_around(winner, texel_x, texel_y, level_side(frame->source_height, level), z_winner,
                                     side * frame->zoom, center, frame, texels);
    store_code(code, to.color, dst, frame->code_offset);
    to.filled_by[dst] = (uchar)(1 + level);
    to.depth[dst] = z;
    to.motion[dst] = px_source.xy - center;
    return true;
}

/* Fills the open pixels that remembered fragments won, but for movers' hidden parts. Where holes continue their far
   side, these colors are mixed with it, a team of work-items for each. Shows parts that reappear, too, with the color
   that the frame before showed there. */
WALK __kernel void
fill_hidden(__constant Frame *restrict frame, __global const half *color_prev, __global const float *depth_prev,
            __global const half *frame_color, __global const float *frame_depth, __global const float2 *source_motion,
            __global const float *target_position, __global const uint *levels_color,
            __global const float *levels_depth, __global const int *levels_px, __global const uchar *levels_state,
            __global const uint *open, __global const uint *offered, __global const uchar *disoccluded,
            __global const Key *keys, __global const uint *winners, __global half *color, __global float *depth,
            __global float2 *motion, __global uchar *filled_by, __global uchar *is_dynamic) {
    __local Side sides[TEAMS][DIRECTIONS];
    __local float4 changes[TEAMS][DIRECTIONS];
    __local int is_filled[TEAMS];
    const Winning won = {color_prev, depth_prev, source_motion, target_position, keys, winners};
    const NewFrame to = {color, depth, motion, filled_by};
    const Texels texels = {.color = levels_color,
                           .frame_color = frame_color,
                           .depth = levels_depth,
                           .frame_depth = frame_depth,
                           .px = levels_px,
                           .state = levels_state};
    const int width = frame->target_width, item = get_local_id(0), team = item / TEAM;
    for (uint i = get_global_id(0); i < offered[0]; i += get_global_size(0)) {
        const int dst = (int)LISTED(offered, i);
        const Part part = part_at(dst, frame, won);
        store_color(part.rgb, color, dst);
        depth[dst] = part.z;
        motion[dst] = part.motion;
        is_dynamic[dst] = DYNAMIC;
    }
    const uint count = frame->levels ? open[0] : 0;
    for (uint first = get_group_id(0) * TEAMS; first < count; first += get_num_groups(0) * TEAMS) {
        const uint own = item < TEAMS ? entry_of(open, first + item) : NO_ENTRY;
        if (item < TEAMS) is_filled[item] = own != NO_ENTRY && fill_pixel((int)own, texels, frame, won, to);
        WAIT_FOR_TEAM();
        const bool mixes = frame->far_side && is_filled[team];
        const int hole = mixes ? (int)entry_of(open, first + team) : 0;
        for (int k = item % TEAM; mixes && k < DIRECTIONS; k += TEAM)
            sides[team][k] = look_beside(hole % width, hole / width, k, frame, disoccluded, won, to);
        WAIT_FOR_TEAM();
        const int far = mixes ? far_side(sides[team]) : 0;
        for (int k = item % TEAM; k < DIRECTIONS; k += TEAM)
            if (has(far, k)) changes[team][k] = change_around(k, &sides[team][k], frame, disoccluded, won, to);
        WAIT_FOR_TEAM();
        if (frame->far_side && item < TEAMS && is_filled[item])
            mix_far_side((int)own, sides[item], changes[item], frame, color);
        WAIT_FOR_TEAM();
    }
}
