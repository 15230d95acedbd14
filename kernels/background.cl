/* Hierarchical background collection and projection (paper: 'Hierarchical Background Collection').
   Level l has ceil(W / 2^l) x ceil(H / 2^l) texels over the rendered image. A texel holds one fragment: its colour, its view
   depth and its pixel position (not the texel's centre) in the camera of the frame for which the level was collected. */

#include "common.h"
#include "nearest.h"

#define EMPTY 0
#define SHOWN 1        /* a static fragment of the current frame: the warp projects it */
#define REMEMBERED 2   /* of an earlier frame */

#define SAME_SURFACE 0.02f   /* relative depth within which two fragments may be of the same surface */
#define GROW 2               /* px around dynamic or nearer fragments where colours may be mixed with theirs */
#define NEARER 0.9f

inline int level_side(const int side, const int level) { return (side + (1 << level) - 1) >> level; }

/* B_0 starts from the static fragments of the rendered frame. Left out are those whose colour may be mixed with that of a
   dynamic or nearer neighbour. */
__kernel void collect_shown(const int source_width, const int source_height, const int collect, __global const half *color,
                            __global const float *depth, __global const uchar *dynamic_mask,
                            __global half *level_color, __global float *level_depth, __global float2 *level_px,
                            __global uchar *level_state) {
    const int src_x = get_global_id(0), src_y = get_global_id(1);
    if (src_x >= source_width || src_y >= source_height) return;
    const int src = src_y * source_width + src_x;
    const float z = depth[src];
    bool keep = collect && !INVALID_DEPTH(z);
    for (int dy = -GROW; dy <= GROW; ++dy)
        for (int dx = -GROW; dx <= GROW; ++dx) {
            if (!inside(src_x + dx, src_y + dy, source_width, source_height)) continue;
            const int near = src + dy * source_width + dx;
            keep = keep && !dynamic_mask[near] && !(depth[near] < z * NEARER);
        }
    level_state[src] = keep ? SHOWN : EMPTY;
    level_depth[src] = z;
    level_px[src] = pixel_centre(src_x, src_y);
    store_color(load_color(color, src), level_color, src);
}

/* How much the depth of the surface at pixel i changes within a pixel. */
inline float slope_at(const int src, const int source_width, __global const float *depth, __global const uchar *links) {
    const int bits = links[src];
    const float z = depth[src];
    float most = 0.0f;
    if (isinf(z)) return 0.0f;
    if (bits & LINK_RIGHT) most = fmax(most, fabs(depth[src + 1] - z));
    if (bits & LINK_LEFT) most = fmax(most, fabs(depth[src - 1] - z));
    if (bits & LINK_DOWN) most = fmax(most, fabs(depth[src + source_width] - z));
    if (bits & LINK_UP) most = fmax(most, fabs(depth[src - source_width] - z));
    return most;
}

/* Whether the current frame allows a static fragment of depth z at pixel `src`: not in front of what is seen there (it would be
   seen, so it is gone), behind it where that is dynamic. *behind: hidden by it. */
inline bool may_be_at(const int src, const float z, const int source_width, __global const float *depth,
                      __global const uchar *dynamic_mask, __global const uchar *links, float *margin, bool *behind) {
    const float z_shown = depth[src];
    *margin = 0.0f;
    *behind = true;
    if (INVALID_DEPTH(z_shown)) return true;
    *margin = SAME_SURFACE * z_shown + slope_at(src, source_width, depth, links);
    *behind = isinf(z) ? !isinf(z_shown) : z > z_shown + *margin;
    const bool before = isinf(z_shown) ? !isinf(z) : z < z_shown - *margin;
    return !before && (*behind || !dynamic_mask[src]);
}

#define OWN_TEXEL 0
#define TOUCHED_TEXELS 1

/* Every fragment of B'_level is offered, where it lies now (phase OWN_TEXEL), to B_level if that is still empty there (case 1:
   fill_keys), or to the next level if it lies behind what B_level holds (case 2: push_keys). Then (phase TOUCHED_TEXELS) to the
   texels that are still empty and that it touches: without that, fragments that move by less than half a pixel per frame would
   never get past the border of what the current frame shows, and fragments that met in one texel would leave a gap beside it. */
__kernel void scatter_level(const int source_width, const int source_height, const int level, const int last_level,
                            const int phase,
                            const int pass, const Reprojection to_current, __global const float *depth,
                            __global const uchar *dynamic_mask, __global const uchar *links,
                            __global const float *old_depth, __global const float2 *old_px,
                            __global const uchar *old_state, __global const float *level_depth,
                            __global const uchar *level_state, __global Key *fill_keys, __global uint *fill_winners,
                            __global Key *push_keys, __global uint *push_winners) {
    const int texel_x = get_global_id(0), texel_y = get_global_id(1);
    const int level_width = level_side(source_width, level), level_height = level_side(source_height, level);
    if (texel_x >= level_width || texel_y >= level_height) return;
    const int texel = texel_y * level_width + texel_x;
    if (old_state[texel] == EMPTY) return;
    const float3 now = reproject(old_px[texel], old_depth[texel], to_current);
    const float z = now.z;
    if (!(z > 0.0f && now.x >= 0.0f && now.y >= 0.0f && now.x < (float)source_width && now.y < (float)source_height)) return;
    const int src_x = (int)floor(now.x), src_y = (int)floor(now.y);
    float margin;
    bool behind;

    if (phase == TOUCHED_TEXELS) {
        const float reach = 0.499f * (float)(1 << level);
        for (int k = 0; k < 4; ++k) {
            const float px_x = now.x + ((k & 1) ? reach : -reach), px_y = now.y + ((k >> 1) ? reach : -reach);
            const int corner_x = (int)floor(px_x), corner_y = (int)floor(px_y);
            if (!inside(corner_x, corner_y, source_width, source_height)) continue;
            const int cell = (corner_y >> level) * level_width + (corner_x >> level);
            if (level_state[cell] != EMPTY) continue;
            if (!may_be_at(corner_y * source_width + corner_x, z, source_width, depth, dynamic_mask, links, &margin,
                           &behind)) continue;
            if (level == 0 || behind) offer(pass, fill_keys, fill_winners, cell, z, (uint)texel);
        }
        return;
    }
    if (!may_be_at(src_y * source_width + src_x, z, source_width, depth, dynamic_mask, links, &margin, &behind)) return;
    if (level > 0 && !behind) return;  /* seen again: B_0 has it fresh */
    const int cell = (src_y >> level) * level_width + (src_x >> level);
    if (level_state[cell] == EMPTY) {
        offer(pass, fill_keys, fill_winners, cell, z, (uint)texel);
    } else if (level < last_level) {
        const float z_level = level_depth[cell];
        const float level_margin = level == 0 ? margin : 2.0f * SAME_SURFACE * z_level;
        if (isinf(z) ? !isinf(z_level) : z > z_level + level_margin) {
            const int next_width = level_side(source_width, level + 1);
            offer(pass, push_keys, push_winners, (src_y >> (level + 1)) * next_width + (src_x >> (level + 1)), z,
                  (uint)texel);
        }
    }
}

/* Writes the winners of fill_keys or push_keys, fragments of an old level, into a level; `restart` empties the rest. */
SPARSE __kernel void settle_level(const int level_width, const int level_height, const int restart,
                                  const Reprojection to_current, __global const Key *keys, __global const uint *winners,
                                  __global const half *old_color, __global const float *old_depth,
                                  __global const float2 *old_px, __global half *level_color, __global float *level_depth,
                                  __global float2 *level_px, __global uchar *level_state) {
    const int texel_x = get_global_id(0), texel_y = get_global_id(1);
    if (texel_x >= level_width || texel_y >= level_height) return;
    const int texel = texel_y * level_width + texel_x;
    const uint winner = winner_of(keys, winners, texel);
    if (winner == NOBODY) {
        if (restart) level_state[texel] = EMPTY;
        return;
    }
    const float3 now = reproject(old_px[winner], old_depth[winner], to_current);
    level_state[texel] = REMEMBERED;
    level_depth[texel] = now.z;
    level_px[texel] = now.xy;
    vstore_half4_rte(vload_half4(winner, old_color), texel, level_color);
}

/* ---- projection --------------------------------------------------------------------------------------------- */

#define LEVEL_SHIFT 28           /* of the level in the index of a projected fragment */
#define ENOUGH_WEIGHT 0.5f
#define REACH 16.0f              /* px: the most that a texel covers to each side */
#define FOOTPRINT_HALF 1.25f     /* of a texel's side: of fragments that met in a texel one is left, so gaps reach two texels */

/* Offers the remembered fragments of a level to the pixels that the warp left invalid, and those of the same surface to
   pixels whose own colour is a makeshift: their fragment's colour was mixed with that of a silhouette. */
__kernel void project_level(const int source_width, const int source_height, const int level, const int target_width,
                            const int target_height, const int pass, const float2 zoom, const Reprojection to_target,
                            __global const float *level_depth, __global const float2 *level_px,
                            __global const uchar *level_state, __global const uchar *disoccluded,
                            __global const uchar *mixed, __global const float *depth, __global Key *keys,
                            __global uint *winners) {
    const int texel_x = get_global_id(0), texel_y = get_global_id(1);
    const int level_width = level_side(source_width, level), level_height = level_side(source_height, level);
    if (texel_x >= level_width || texel_y >= level_height) return;
    const int texel = texel_y * level_width + texel_x;
    if (level_state[texel] != REMEMBERED) return;
    const float z_source = level_depth[texel];
    const float3 there = reproject(level_px[texel], z_source, to_target);
    if (!(there.z > 0.0f && there.x > -REACH && there.y > -REACH && there.x < (float)target_width + REACH
          && there.y < (float)target_height + REACH)) return;
    const float nearer = isinf(there.z) ? 1.0f : divide(z_source, there.z);
    const float side = (float)(1 << level) * FOOTPRINT_HALF * nearer;
    const float half_x = fmin(fmax(side * zoom.x, 0.5f), REACH), half_y = fmin(fmax(side * zoom.y, 0.5f), REACH);
    const int x0 = max((int)ceil(there.x - half_x - 0.5f), 0), x1 = min((int)floor(there.x + half_x - 0.5f),
                                                                        target_width - 1);
    const int y0 = max((int)ceil(there.y - half_y - 0.5f), 0), y1 = min((int)floor(there.y + half_y - 0.5f),
                                                                        target_height - 1);
    for (int dst_y = y0; dst_y <= y1; ++dst_y)
        for (int dst_x = x0; dst_x <= x1; ++dst_x) {
            const int dst = dst_y * target_width + dst_x;
            const float z = depth[dst];
            const bool alike = is_same_surface(there.z, z, SAME_SURFACE * z);
            if (disoccluded[dst] || (mixed[dst] && alike))
                offer(pass, keys, winners, dst, there.z, (uint)texel | ((uint)level << LEVEL_SHIFT));
        }
}

#define INSIDE_REACH 8           /* px to each side between which a hole counts as inside a moving object */
#define ONE_OBJECT 0.05f         /* relative depth within which two dynamic fragments are of one object */

/* Depth of the first pixel that is not disoccluded from (x, y) in a direction, if it is dynamic; else -1. */
inline float dynamic_beside(const int dst_x, const int dst_y, const int dx, const int dy, const int target_width,
                            const int target_height,
                            __global const uchar *disoccluded, __global const uchar *is_dynamic, __global const float *depth) {
    for (int t = 1; t <= INSIDE_REACH; ++t) {
        const int beside_x = dst_x + t * dx, beside_y = dst_y + t * dy;
        if (!inside(beside_x, beside_y, target_width, target_height)) return -1.0f;
        const int beside = beside_y * target_width + beside_x;
        if (!disoccluded[beside]) return is_dynamic[beside] ? depth[beside] : -1.0f;
    }
    return -1.0f;
}

/* Whether the hole at (x, y) lies between two parts of one moving object: then it is the object's, not the background's. */
inline bool inside_mover(const int dst_x, const int dst_y, const int target_width, const int target_height,
                         __global const uchar *disoccluded,
                         __global const uchar *is_dynamic, __global const float *depth) {
    for (int axis = 0; axis < 2; ++axis) {
        const int dx = axis == 0, dy = axis == 1;
        const float a = dynamic_beside(dst_x, dst_y, dx, dy, target_width, target_height, disoccluded, is_dynamic, depth);
        const float b = dynamic_beside(dst_x, dst_y, -dx, -dy, target_width, target_height, disoccluded, is_dynamic, depth);
        if (a > 0.0f && b > 0.0f && fabs(a - b) <= ONE_OBJECT * fmin(a, b)) return true;
    }
    return false;
}

/* Fills the pixels that fragments of this level won, from the level's texels around the winner: weighted by
   their distance in the target image, of the winner's surface only. */
SPARSE __kernel void fill_from_level(const int source_width, const int source_height, const int level, const int target_width,
                              const int target_height, const float2 zoom, const Reprojection to_target,
                              const Reprojection to_source, __global const half *level_color,
                              __global const float *level_depth, __global const float2 *level_px,
                              __global const uchar *level_state, __global const uchar *disoccluded,
                              __global const uchar *is_dynamic, __global const Key *keys,
                              __global const uint *winners, __global half *color, __global float *out_depth,
                              __global float2 *motion, __global uchar *filled_by) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    const uint winner = winner_of(keys, winners, dst);
    if (winner == NOBODY || (int)(winner >> LEVEL_SHIFT) != level) return;
    if (disoccluded[dst] && inside_mover(dst_x, dst_y, target_width, target_height, disoccluded, is_dynamic,
                                         out_depth)) return;
    const int texel = winner & ((1u << LEVEL_SHIFT) - 1);
    const int level_width = level_side(source_width, level), level_height = level_side(source_height, level);
    const int texel_x = texel % level_width, texel_y = texel / level_width;
    const float z_winner = level_depth[texel];
    const float2 centre = pixel_centre(dst_x, dst_y);

    const float nearest_z = reproject(level_px[texel], z_winner, to_target).z;
    const float3 px_source = reproject(centre, nearest_z, to_source);
    if (!(px_source.z > 0.0f && px_source.x >= 0.0f && px_source.y >= 0.0f && px_source.x < (float)source_width
          && px_source.y < (float)source_height)) return;  /* out of screen: only the footprint reaches there */
    const float nearer = isinf(nearest_z) ? 1.0f : divide(z_winner, nearest_z);
    const float side_x = (float)(1 << level) * nearer * zoom.x, side_y = (float)(1 << level) * nearer * zoom.y;
    /* Within one texel's side; within two where that catches too little, as in the gaps between irregular fragments. */
    float3 sum;
    float weight_sum;
    for (int reach = 1; reach <= 2; ++reach) {
        sum = (float3)(0.0f);
        weight_sum = 0.0f;
        const float inverse_x = divide(1.0f, side_x * (float)reach), inverse_y = divide(1.0f, side_y * (float)reach);
        for (int dy = -reach; dy <= reach; ++dy)
            for (int dx = -reach; dx <= reach; ++dx) {
                if (!inside(texel_x + dx, texel_y + dy, level_width, level_height)) continue;
                const int tap = texel + dy * level_width + dx;
                const float z = level_depth[tap];
                if (level_state[tap] == EMPTY) continue;
                if (!is_same_surface(z, z_winner, 2.0f * SAME_SURFACE * z_winner)) continue;
                const float3 there = reproject(level_px[tap], z, to_target);
                if (!(there.z > 0.0f)) continue;
                const float wx = 1.0f - fabs(there.x - centre.x) * inverse_x;
                const float wy = 1.0f - fabs(there.y - centre.y) * inverse_y;
                if (!(wx > 0.0f && wy > 0.0f)) continue;
                sum += wx * wy * load_color(level_color, tap);
                weight_sum += wx * wy;
            }
        if (weight_sum >= ENOUGH_WEIGHT) break;
    }
    store_color(weight_sum > 0.01f ? mean_of(sum, weight_sum) : load_color(level_color, texel), color, dst);
    filled_by[dst] = (uchar)(1 + level);
    if (!disoccluded[dst]) return;
    out_depth[dst] = nearest_z;
    motion[dst] = px_source.xy - centre;
}
