/* Hierarchical background collection and projection (paper: 'Hierarchical Background Collection'). Level l has
   ceil(W / 2^l) x ceil(H / 2^l) texels over the rendered image. A texel holds one fragment: its color, its view
   depth and its pixel position (not the texel's center) in the camera of the frame for which the level was
   collected. What is SHOWN is not stored: it is that frame's own pixel. Level 0 remembers what movers hide, the next
   one what static surfaces hide. Stored positions are two 16-bit offsets from the texel's
   center, x in the lower half, in PX_UNITS of the texel's side: that holds what TOUCHES it. Stored colors are RGB9E5.
   Fragments of B'_l that only meet the surface that they are of are skipped LANES at once. */

#include "frame.h"
#include "simd.h"
#include "nearest.h"
#include "blocks.h"
#include "lists.h"
#include "rgb9e5.h"
#include "color_code.h"
#include "far_side.h"

/* What set the thresholds: docs/deviations.md, "Fragments must be deeper by a margin (case 2)", "Background texels
   cover what they map to". */
#define SAME_LEVEL 0.02f /* relative depth within which two fragments may be of the same surface */
#define FROM_MEMORY 0x80000000u  /* of a texel's index: it refers to a REMEMBERED fragment, not to a SHOWN one */

#define PX_UNITS 32768.0f       /* of a stored position, per side of a texel */

/* A pixel position from the center of a texel, packed. */
INLINE int pack_px(const float2 offset, const int level) {
    const float2 units = clamp(rint(offset * (PX_UNITS / (float)(1 << level))), -PX_UNITS, PX_UNITS - 1.0f);
    return ((int)units.x & 0xFFFF) | ((int)units.y << 16);
}

/* The levels lie one after another: `starts` are the first texels of levels 1 to 3, and the end. */
INLINE int level_of(const int texel, const int4 starts) {
    return (texel >= starts.x) + (texel >= starts.y) + (texel >= starts.z);
}

INLINE int start_of(const int level, const int4 starts) {
    return level == 0 ? 0 : level == 1 ? starts.x : level == 2 ? starts.y : level == 3 ? starts.z : starts.w;
}

INLINE int size_of(const int level, __constant Frame *frame) {
    return level_side(frame->source_width, level) * level_side(frame->source_height, level);
}

/* Texels of a level, or of all, to read, and the frame whose pixels are those that are SHOWN. */
typedef struct {
    __global const uint *color;
    __global const half *frame_color;
    __global const float *depth, *frame_depth;
    __global const int *px;
    __global const uchar *state;
    int level, width;  /* of that level, or of the one that is read now */
} Texels;

/* The depth of the SHOWN fragment of a texel, or of the REMEMBERED one. */
INLINE float depth_of(const Texels t, const int texel, const bool shown) {
    return shown ? t.frame_depth[texel] : t.depth[texel];
}

/* `texel` is at (x, y) of its level. */
INLINE float2 px_of(const Texels t, const int texel, const int x, const int y, const bool shown) {
    const float2 center = pixel_center(x, y) * (float)(1 << t.level);
    if (shown) return center;
    const int packed = t.px[texel];
    return center + (float2)((float)((packed << 16) >> 16), (float)(packed >> 16)) * ((float)(1 << t.level) / PX_UNITS);
}

INLINE float3 code_of(const Texels t, const int texel, const bool shown, const float code_offset) {
    const float3 c = shown ? load_color(t.frame_color, texel) : unpack_color(t.color[texel]);
    return encode_color(c, code_offset);
}

/* ---- collection --------------------------------------------------------------------------------------------- */

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
   nothing is collected: all are EMPTY. */
SCAN_FLAT __kernel void settle_levels(__constant Frame *restrict frame, __global const Key *keys,
                                      __global const uint *winners, __global const half *frame_color,
                                      __global const float *frame_depth, __global const uint *old_color,
                                      __global const float *old_depth, __global const int *old_px,
                                      __global uint *levels_color, __global float *levels_depth,
                                      __global int *levels_px, __global uchar *levels_state) {
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

/* ---- projection --------------------------------------------------------------------------------------------- */

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

/* Offers a fragment to the pixels from (x0, y0) to (x1, y1) that the warp left invalid. */
INLINE void offer_to_pixels(const int x0, const int y0, const int x1, const int y1, const float z, const uint texel,
                            const Uncovered to) {
    for (int dst_y = y0; dst_y <= y1; ++dst_y) {
        const int first = dst_y * to.width + x0, last = dst_y * to.width + x1;
        if (first + RUN <= to.pixels && last - first < RUN && run_is_zero(to.disoccluded + first)) continue;
        for (int dst = first; dst <= last; ++dst)
            if (to.disoccluded[dst]) offer(to.pass, to.keys, to.winners, dst, z, texel);
    }
}

/* Offers the remembered fragments of all levels; texels between two levels are EMPTY. */
SCAN_FLAT __kernel void project_levels(__constant Frame *restrict frame, const int pass,
                                       __global const float *levels_depth, __global const int *levels_px,
                                       __global const uchar *levels_state, __global const uchar *disoccluded,
                                       __global Key *keys, __global uint *winners) {
    __local ushort found[SCAN_GROUP * SCAN_BYTES];
    __local uint count;
    const int4 starts = frame->level_starts;
    const int target_width = frame->target_width, target_height = frame->target_height;
    const Uncovered to = {.width = target_width,
                          .pixels = target_width * target_height,
                          .pass = pass,
                          .disoccluded = disoccluded,
                          .keys = keys,
                          .winners = winners};
    const float2 zoom = frame->zoom;
    const int first = scan_for(REMEMBERED, levels_state, starts.w, found, &count);
    for (uint i = get_local_id(0); i < count; i += SCAN_GROUP) {
        const int texel = first + found[i], level = level_of(texel, starts), in_level = texel - start_of(level, starts);
        const int width = level_side(frame->source_width, level);
        const Texels texels = {.px = levels_px, .level = level, .width = width};
        const float z_source = levels_depth[texel];
        const float2 px = px_of(texels, texel, in_level % width, in_level / width, false);
        const float3 there = reproject(px, z_source, frame->to_target);
        if (!(there.z > 0.0f && there.x > -TEXEL_REACH && there.y > -TEXEL_REACH
              && there.x < (float)target_width + TEXEL_REACH && there.y < (float)target_height + TEXEL_REACH))
            continue;
        const float nearer = isinf(there.z) ? 1.0f : divide(z_source, there.z);
        const float side = TEXEL_HALF * (float)(1 << level) * nearer;
        const float half_x = fmin(fmax(side * zoom.x, 0.5f), TEXEL_REACH),
                    half_y = fmin(fmax(side * zoom.y, 0.5f), TEXEL_REACH);
        offer_to_pixels(max((int)ceil(there.x - half_x - 0.5f), 0), max((int)ceil(there.y - half_y - 0.5f), 0),
                        min((int)floor(there.x + half_x - 0.5f), target_width - 1),
                        min((int)floor(there.y + half_y - 0.5f), target_height - 1), there.z, (uint)texel, to);
    }
}

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

/* ---- colors beside ------------------------------------------------------------------------------------------ */

#define MIXED_REACH 16 /* px beyond which the far side does not represent the remembered surface */

#define FAR_COUNTS 0.5f /* px: weight of the far side per 1 / distance, a remembered color having 1 */
#define BEYOND_EDGE 4 /* px beyond the edge of a hole, where colors do not change with the mover's outline */
#define LEAST_CHANGE 0.001f /* squared change around, by which remembered colors count half; white is 1 */
#define CONTRAST_COUNTS 4.0f /* of the squared difference from colors around, times that by which it counts half */

/* The frame before. */
typedef struct {
    __global const half *color;
    __global const float *depth;
} Before;

/* Code of the color of a static point in the frame before; false where that did not show its surface all around. */
INLINE bool shown_before(const float2 center, const float z, __constant Frame *frame, const Before before,
                         float3 *code) {
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
        if (!is_same_surface(before.depth[i], px_prev.z, 2.0f * SAME_LEVEL * px_prev.z)) return false;
        sum += bilinear_weight(tap, u, v) * load_code(before.color, i, frame->code_offset);
    }
    *code = sum;
    return true;
}

/* What is around a hole of the background, BEYOND_EDGE px beyond `side` in direction k: its code in the frame before,
   and the squared change since then, or -1 where that frame did not show it. */
INLINE float4 change_around(const int k, __local const Side *side, __constant Frame *frame, const Before before,
                            __global const uchar *disoccluded, __global const float *depth,
                            __global const half *color) {
    const float4 unknown = (float4)(0.0f, 0.0f, 0.0f, -1.0f);
    const int width = frame->target_width;
    const int2 d = BEYOND_EDGE * direction(k);
    const int dst_x = side->px % width + d.x, dst_y = side->px / width + d.y, dst = dst_y * width + dst_x;
    if (!side->meets || !inside(dst_x, dst_y, width, frame->target_height) || disoccluded[dst]) return unknown;
    const float z = depth[dst];
    float3 code;
    if (!is_as_far(inverse_of(z), side->inverse) || !shown_before(pixel_center(dst_x, dst_y), z, frame, before, &code))
        return unknown;
    const float3 change = load_code(color, dst, frame->code_offset) - code;
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

/* The new frame, and which remembered fragments won its pixels. */
typedef struct {
    __global const Key *keys;
    __global const uint *winners;
    __global half *color;
    __global float *depth;
    __global float2 *motion;
    __global uchar *filled_by;
} NewFrame;

/* Fills an open pixel that a remembered fragment won, unless it is a mover's. `texels`: of all levels. Returns whether
   it is filled. */
INLINE bool fill_pixel(const int dst, Texels texels, __constant Frame *frame, const NewFrame to) {
    const int dst_x = dst % frame->target_width, dst_y = dst / frame->target_width;
    const uint winner = winner_of(to.keys, to.winners, dst);
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
   side, these colors are mixed with it, a team of work-items for each. */
WALK __kernel void fill_from_levels(__constant Frame *restrict frame, __global const half *color_prev,
                                    __global const float *depth_prev, __global const half *frame_color,
                                    __global const float *frame_depth, __global const uint *levels_color,
                                    __global const float *levels_depth, __global const int *levels_px,
                                    __global const uchar *levels_state, __global const uint *open,
                                    __global const uchar *disoccluded, __global const Key *keys,
                                    __global const uint *winners, __global half *color, __global float *depth,
                                    __global float2 *motion, __global uchar *filled_by) {
    __local Side sides[TEAMS][DIRECTIONS];
    __local float4 changes[TEAMS][DIRECTIONS];
    __local int is_filled[TEAMS];
    const Before before = {color_prev, depth_prev};
    const NewFrame to = {keys, winners, color, depth, motion, filled_by};
    const Texels texels = {.color = levels_color,
                           .frame_color = frame_color,
                           .depth = levels_depth,
                           .frame_depth = frame_depth,
                           .px = levels_px,
                           .state = levels_state};
    const int width = frame->target_width, item = get_local_id(0), team = item / TEAM;
    for (uint first = get_group_id(0) * TEAMS; first < open[0]; first += get_num_groups(0) * TEAMS) {
        const uint own = item < TEAMS ? entry_of(open, first + item) : NO_ENTRY;
        if (item < TEAMS) is_filled[item] = own != NO_ENTRY && fill_pixel((int)own, texels, frame, to);
        WAIT_FOR_TEAM();
        const bool mixes = frame->far_side && is_filled[team];
        const int hole = mixes ? (int)entry_of(open, first + team) : 0;
        for (int k = item % TEAM; mixes && k < DIRECTIONS; k += TEAM)
            sides[team][k] = look(hole % width, hole / width, k, MIXED_REACH, frame, disoccluded, 1, depth, color);
        WAIT_FOR_TEAM();
        const int far = mixes ? far_side(sides[team]) : 0;
        for (int k = item % TEAM; k < DIRECTIONS; k += TEAM)
            if (has(far, k))
                changes[team][k] = change_around(k, &sides[team][k], frame, before, disoccluded, depth, color);
        WAIT_FOR_TEAM();
        if (frame->far_side && item < TEAMS && is_filled[item])
            mix_far_side((int)own, sides[item], changes[item], frame, color);
        WAIT_FOR_TEAM();
    }
}
