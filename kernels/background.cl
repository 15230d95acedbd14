/* Collection of the hierarchical background (paper: 'Hierarchical Background Collection'), whose levels are those of
   levels.h. Fragments of the frame before, B'_l, are offered to the levels where they lie now; the nearest settle
   there. Fragments of B'_l that only meet the surface that they are of are skipped LANES at once. */

#include "levels.h"
#include "nearest.h"
#include "acceleration.h"
#include "blocks.h"
#include "lists.h"

#define FROM_MEMORY 0x80000000u  /* of a texel's index: it refers to a REMEMBERED fragment, not to a SHOWN one */

/* A pixel position from the center of a texel, packed. */
INLINE int pack_px(const float2 offset, const int level) {
    const float2 units = clamp(rint(offset * (PX_UNITS / (float)(1 << level))), -PX_UNITS, PX_UNITS - 1.0f);
    return ((int)units.x & 0xFFFF) | ((int)units.y << 16);
}

/* The amount by which the depth of the surface at pixel i changes within a pixel. */
INLINE float slope_at(const int src, const int source_width, __global const float *depth, __global const uchar *links) {
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

/* Whether the current frame allows a static fragment of depth z at pixel `src`: not in front of the visible surface
   (it would be seen, so it is gone), behind it where that is dynamic. *behind: hidden by it. */
INLINE bool may_be_at(const int src, const float z, const int source_width, __global const float *depth,
                      __global const uchar *dynamic_mask, __global const uchar *links, float *margin, bool *behind) {
    const float z_shown = depth[src];
    *margin = 0.0f;
    *behind = true;
    if (INVALID_DEPTH(z_shown)) return true;
    *margin = SAME_LEVEL * z_shown;
    if (fabs(z - z_shown) > *margin) *margin += slope_at(src, source_width, depth, links);
    *behind = isinf(z) ? !isinf(z_shown) : z > z_shown + *margin;
    const bool before = isinf(z_shown) ? !isinf(z) : z < z_shown - *margin;
    return !before && (*behind || !dynamic_mask[src]);
}

#define BEHIND (1.0f - 0.95f * SAME_LEVEL)  /* times the depth of a fragment: nearer surfaces hide it */
#define TOUCHES 0.499f       /* of a texel's side: reach of a fragment to neighboring texels */

/* The current frame, and the receivers of the fragments of a level, among the texels of all levels. */
typedef struct {
    int width, height, level, last_level, pass;
    int first, next; /* texels of this level and of the one below */
    __global const float *depth;
    __global const uchar *dynamic_mask, *links;
    __global uchar *levels_state; /* before this level is filled */
    __global Key *keys;
    __global uint *winners;
} Collection;

INLINE Collection collection_of(__constant Frame *frame, const int level, const int pass, __global const float *depth,
                                __global const uchar *dynamic_mask, __global const uchar *links,
                                __global uchar *levels_state, __global Key *keys, __global uint *winners) {
    const int width = frame->source_width, height = frame->source_height, last_level = frame->levels - 1;
    const int first = start_of(level, frame->level_starts), next = start_of(level + 1, frame->level_starts);
    const Collection made = {width, height,       level, last_level,   pass, first,  next,
                             depth, dynamic_mask, links, levels_state, keys, winners};
    return made;
}

/* Offers a fragment of B'_level, where it lies now, to B_level if its texel is still empty (case 1), or to the next
   level if it lies behind the fragment in B_level (case 2): what is pushed there takes its texel before that level's
   own fragments come. And to the empty texels that it touches, where every fragment of their own goes before:
   without that, fragments that move by less than half a pixel per frame would never get past the border of the
   visible area of the current frame, and fragments that met in one texel would leave a gap beside it. */
INLINE void offer_fragment(const float3 now, const uint texel, const Collection to) {
    if (!lands(now, to.width, to.height)) return;
    const int level = to.level, level_width = level_side(to.width, level);
    const float z = now.z;
    const int src_x = (int)now.x, src_y = (int)now.y;
    const int own = to.first + (src_y >> level) * level_width + (src_x >> level);
    float margin;
    bool behind;
    int filled = -1;
    if (may_be_at(src_y * to.width + src_x, z, to.width, to.depth, to.dynamic_mask, to.links, &margin, &behind)
        && (level == 0 || behind)) {  /* else it is seen again: B_0 has it fresh */
        if (to.levels_state[own] == EMPTY) {
            offer(to.pass, to.keys, to.winners, own, z, texel);
            filled = own;
        } else if (level < to.last_level) {
            const float z_level = level == 0 ? to.depth[own] : as_float(depth_bits_of(to.keys, own));
            const float level_margin = level == 0 ? margin : 2.0f * SAME_LEVEL * z_level;
            if (isinf(z) ? !isinf(z_level) : z > z_level + level_margin) {
                const int below =
                    to.next + (src_y >> (level + 1)) * level_side(to.width, level + 1) + (src_x >> (level + 1));
                offer(to.pass, to.keys, to.winners, below, z, texel);
                to.levels_state[below] = REMEMBERED;
            }
        }
    }
    const float reach = TOUCHES * (float)(1 << level);
    for (int k = 0; k < 4; ++k) {
        const float px_x = now.x + ((k & 1) ? reach : -reach), px_y = now.y + ((k >> 1) ? reach : -reach);
        const int corner_x = (int)px_x, corner_y = (int)px_y;
        if (px_x < 0.0f || px_y < 0.0f || corner_x >= to.width || corner_y >= to.height) continue;
        const int cell = to.first + (corner_y >> level) * level_width + (corner_x >> level);
        const uint bits = as_uint(z) | GIVES_WAY;
        if (cell == filled || (level == 0 && cell == own) || to.levels_state[cell] != EMPTY
            || !may_win(to.pass, to.keys, cell, bits))
            continue;
        if (may_be_at(corner_y * to.width + corner_x, z, to.width, to.depth, to.dynamic_mask, to.links, &margin,
                      &behind)
            && (behind || level == 0))
            offer_bits(to.pass, to.keys, to.winners, cell, bits, texel);
    }
}

/* Whether nothing can be offered of LANES fragments of B'_0, which lie roughly here now: they land in one row, almost
   side by side, and three rows of texels, which hold all that they touch, are taken, by what is not nearer than their
   own surface, if there is a next level. */
INLINE bool only_meet_surfaces(const Wide3 now, const Collection to) {
    const int row = to.width, size = row * to.height, edge = RUN / 4;
    const float error = ROUGHLY * (float)max(to.width, to.height);
    const Ints in = (now.z > 0.0f) & (now.x > 1.0f) & (now.y > 1.0f) & (now.x < (float)(to.width - 1))
                    & (now.y < (float)(to.height - 1));
    if (!ALL(in)) return false;
    const Ints cell_x = to_ints(now.x), cell_y = to_ints(now.y);
    const Ints sure =
        fmax(fabs(now.x - to_floats(cell_x) - 0.5f), fabs(now.y - to_floats(cell_y) - 0.5f)) < 0.5f - error;
    const int first_x = FIRST_LANE(cell_x), cell = FIRST_LANE(cell_y), first = cell * row + first_x;
    if (first < row + edge || first + row + RUN > size
        || !ALL(sure & (cell_y == cell) & (cell_x > first_x - edge) & (cell_x < first_x + RUN - edge - 1)))
        return false;
    __global const uchar *here = to.levels_state + first - edge;
    if (run_has(here, EMPTY) || run_has(here - row, EMPTY) || run_has(here + row, EMPTY)) return false;
    if (to.last_level == 0) return true;
    const bool is_run = ALL(cell_x == first_x + LANE_NUMBERS);
    const Floats z = is_run ? load_floats(0, to.depth + first) : gather_floats(to.depth, cell_x + (first - first_x));
    return !ANY(now.z * BEHIND > z);
}

/* Whether offer_fragment may offer any of B'_0: not one whose texels are all taken, by what is not nearer than its own
   surface if there is a next level. Those are its own and, at most, three on the nearer sides of it. */
INLINE Ints may_be_offered(const Wide3 now, const Collection to) {
    const int row = to.width;
    const Ints in =
        (now.z > 0.0f) & (now.x >= 0.0f) & (now.y >= 0.0f) & (now.x < (float)to.width) & (now.y < (float)to.height);
    const Floats x = in ? now.x : (Floats)(0.0f), y = in ? now.y : (Floats)(0.0f);
    const Ints cell_x = to_ints(x), cell_y = to_ints(y);
    const Ints left = x - to_floats(cell_x) < 0.5f, up = y - to_floats(cell_y) < 0.5f;
    const Ints beside = clamp(cell_x + (left ? (Ints)(-1) : (Ints)(1)), (Ints)(0), (Ints)(row - 1));
    const Ints next = clamp(cell_y + (up ? (Ints)(-1) : (Ints)(1)), (Ints)(0), (Ints)(to.height - 1)) * row,
               own = cell_y * row;
    __global const uchar *state = to.levels_state;
    const Bytes least = min(min(gather_bytes(state, own + cell_x), gather_bytes(state, own + beside)),
                            min(gather_bytes(state, next + cell_x), gather_bytes(state, next + beside)));
    return in
           & ((to_ints(least) == EMPTY)
              | (to.last_level == 0 ? (Ints)(0) : now.z * BEHIND > gather_floats(to.depth, own + cell_x)));
}

/* Offers the fragments of B'_0. */
WIDE __kernel void scatter_level(__constant Frame *restrict frame, const int pass, __global const float *depth,
                                 __global const uchar *dynamic_mask, __global const uchar *links,
                                 __global const int *last_stir, __global const float *frame_depth,
                                 __global const float *old_depth, __global const int *old_px,
                                 __global const uchar *old_state, __global uchar *levels_state, __global Key *keys,
                                 __global uint *winners) {
    const int width = frame->source_width, height = frame->source_height;
    const Reprojection to_current = frame->from_previous;
    const int texel_x = get_global_id(0) * LANES, texel_y = get_global_id(1);
    if (texel_x >= width || texel_y >= height) return;
    if (collects_nothing(block_of(texel_x, texel_y, width), frame, last_stir)) return;
    const int texel = texel_y * width + texel_x;
    const Collection to = collection_of(frame, 0, pass, depth, dynamic_mask, links, levels_state, keys, winners);

    /* LANES texels at once: what the frame before shows there, or what they remember. */
    const int count = width - texel_x;
    const Ints state = to_ints(load_some_bytes(count, old_state + texel));
    const Ints remembered = state == REMEMBERED, held = ((state == SHOWN) | remembered) & (LANE_NUMBERS < count);
    if (!ANY(held)) return;
    Floats px_x = row_centers(texel_x), px_y = (Floats)((float)texel_y + 0.5f);
    Floats z = load_some_floats(count, frame_depth + texel);
    if (ANY(remembered)) {
        const Ints packed = remembered ? load_some_ints(count, old_px + texel) : (Ints)(0);
        px_x += to_floats((packed << 16) >> 16) * (1.0f / PX_UNITS);
        px_y += to_floats(packed >> 16) * (1.0f / PX_UNITS);
        z = remembered ? load_some_floats(count, old_depth + texel) : z;
    }

    /* On CPUs: most only meet the surface that they are of; a rough position tells. */
    if (LANES > 1 && only_meet_surfaces(wide_reproject_roughly(px_x, px_y, z, to_current), to)) return;
    const Wide3 now = wide_reproject(px_x, px_y, z, to_current);
    const Ints wanted = held & may_be_offered(now, to);
    if (!ANY(wanted)) return;

    /* The few that may be offered, one by one. */
    for (int k = 0; k < LANES; ++k) {
        if (!int_of(&wanted, k)) continue;
        const float3 place = (float3)(float_of(&now.x, k), float_of(&now.y, k), float_of(&now.z, k));
        offer_fragment(place, (uint)(texel + k) | (int_of(&remembered, k) ? FROM_MEMORY : 0u), to);
    }
}

/* Offers the fragments of B'_level, which is not B'_0: few. */
SCAN_FLAT __kernel void scatter_hidden(__constant Frame *restrict frame, const int level, const int pass,
                                       __global const float *depth, __global const uchar *dynamic_mask,
                                       __global const uchar *links, __global const float *old_depth,
                                       __global const int *old_px, __global const uchar *old_state,
                                       __global uchar *levels_state, __global Key *keys, __global uint *winners) {
    __local ushort found[SCAN_GROUP * SCAN_BYTES];
    __local uint count;
    const int start = start_of(level, frame->level_starts), level_width = level_side(frame->source_width, level);
    const Texels old = {.px = old_px, .level = level};
    const Collection to = collection_of(frame, level, pass, depth, dynamic_mask, links, levels_state, keys, winners);
    const int first = scan_for(REMEMBERED, old_state + start, size_of(level, frame), found, &count);
    for (uint i = get_local_id(0); i < count; i += SCAN_GROUP) {
        const int in_level = first + found[i], texel = start + in_level;
        const float2 px = px_of(old, texel, in_level % level_width, in_level / level_width, false);
        offer_fragment(reproject(px, old_depth[texel], frame->from_previous), (uint)texel | FROM_MEMORY, to);
    }
}

/* Texels to write. */
typedef struct {
    __global uint *color;
    __global float *depth;
    __global int *px;
    __global uchar *state;
} Levels;

/* Puts the winner of a texel into it, a fragment of the old levels, and empties its keys. `old`: of all levels. */
INLINE void settle(const int texel, const uint winner, Texels old, __constant Frame *frame, const Levels levels) {
    const int4 starts = frame->level_starts;
    const int level = level_of(texel, starts), in_level = texel - start_of(level, starts),
              level_width = level_side(frame->source_width, level);
    const bool shown = !(winner & FROM_MEMORY); /* else stored */
    const int from = (int)(winner & ~FROM_MEMORY);
    const float z = depth_of(old, from, shown);
    old.level = level_of(from, starts);
    const int old_width = level_side(frame->source_width, old.level), in_old = from - start_of(old.level, starts);
    const float2 px = px_of(old, from, in_old % old_width, in_old / old_width, shown);
    const float3 now = reproject(px, z, frame->from_previous);
    const float2 center = pixel_center(in_level % level_width, in_level / level_width) * (float)(1 << level);
    levels.color[texel] = shown ? pack_color(load_color(old.frame_color, from)) : old.color[from];
    levels.depth[texel] = now.z;
    levels.px[texel] = pack_px(now.xy - center, level);
    levels.state[texel] = REMEMBERED;
}

/* Completes all levels: their texels that fragments were offered to; those of level 0 are EMPTY ones. After a reset
   nothing is collected: all are EMPTY. Rows below track movers' acceleration. */
SCAN_FLAT __kernel void
settle_levels(__constant Frame *restrict frame, __global const Key *keys, __global const uint *winners,
              __global const half *frame_color, __global const float *frame_depth, __global const uint *old_color,
              __global const float *old_depth, __global const int *old_px, __global uint *levels_color,
              __global float *levels_depth, __global int *levels_px, __global uchar *levels_state,
              __global const float *depth, __global const float2 *motion, __global const uchar *dynamic_mask,
              __global const float *met_depth, __global const float4 *velocity_prev,
              __global const uint2 *acceleration_prev, __global const uint2 *bend_prev,
              __global const uint2 *view_velocity_prev, __global float4 *velocity, __global uint2 *acceleration,
              __global uint2 *bend, __global uint2 *view_velocity) {
    if (get_global_id(1)) {
        const Tracked fragments = {depth, motion, dynamic_mask, met_depth};
        const Grid before = {velocity_prev, acceleration_prev, bend_prev, view_velocity_prev};
        const Cells to = {velocity, acceleration, bend, view_velocity};
        track_cell((int)((get_global_id(1) - 1) * get_global_size(0) + get_global_id(0)), frame, fragments, before, to);
        return;
    }
    __local ushort found[SCAN_GROUP * SCAN_BYTES];
    __local uint count;
    const int4 starts = frame->level_starts;
    const Texels old = {
        .color = old_color, .frame_color = frame_color, .depth = old_depth, .frame_depth = frame_depth, .px = old_px};
    const Levels levels = {levels_color, levels_depth, levels_px, levels_state};
    const int at = get_global_id(0) * SCAN_BYTES, level = level_of(at, starts);
    const int end = min(at + SCAN_BYTES, start_of(level, starts) + size_of(level, frame));
    for (int texel = at; !frame->has_previous && texel < end; ++texel) levels_state[texel] = EMPTY;
    if (!frame->has_previous) return;
    const int first = scan_for(EMPTY, levels_state, size_of(0, frame), found, &count);
    for (int texel = level == 0 ? end : at; texel < end; ++texel)
        if (winner_of(keys, winners, texel) != NOBODY) found[atomic_inc(&count)] = (ushort)(texel - first);
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = get_local_id(0); i < count; i += SCAN_GROUP) {
        const int texel = first + found[i];
        const uint winner = winner_of(keys, winners, texel);
        if (winner != NOBODY) settle(texel, winner, old, frame, levels);
    }
}
