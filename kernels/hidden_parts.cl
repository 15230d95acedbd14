/* Hidden parts of movers: disocclusions that belong to a moving object, not to the static background. A mover's part
   in a disocclusion moves like the dynamic fragments next to it, so its place in the rendered frame is known. The
   warp brought nothing from there, so the part was hidden, or its depth is invalid. Where that frame shows a surface
   there that is not nearer, the mover has no part there, and the hole is left to the background; so it is where the
   frame before showed something farther where that part was then. A mover at the border of the rendered image that
   enters has parts which no frame has shown: they have its color there.

   A part that the frame before showed, and that something nearer hides in the rendered frame, reappears: it comes out
   before surfaces that are shown, or in a hole. It moves like the mover beside what hides it, and has the
   color that it had. */

#include "frame.h"
#include "simd.h"
#include "nearest.h"
#include "color_code.h"
#include "directional_search.h"
#include "blocks.h"
#include "flow.h"
#include "lists.h"
#include "thresholds.h"

/* What set the thresholds: docs/deviations.md, "Hidden parts of movers", "Parts that the frame before showed
   reappear". */
#define ONE_OBJECT 0.05f  /* relative depth within which two dynamic fragments are of one object ... */
#define HIDES 0.95f       /* ... and times the depth of a mover: nearer surfaces are others, and may hide it ... */
#define MOVER_HIDES 0.8f  /* ... and movers so much nearer do, which are no limbs of its own */
#define BESIDE 3          /* part of the reach within which a mover owns holes beside it, ... */
#define BREADTH 3         /* ... or times the way to it, if it is so broad and far behind what hides it: ... */
#define FAR_BEHIND 0.65f  /* ... by depth over depth */

#define MOVER_REACH 8     /* px, in which movers are looked for ... */
#define MOVER_REACH_SHARE 48    /* ... or this part of the target's width */

/* The new frame, the depth of the rendered one and of the one before it, and the motion between these. */
typedef struct {
    __global const float *source_depth, *depth_prev;
    __global const float2 *source_motion;
    __global const half *source_color;
    __global const uchar *dynamic_mask;
    __global const float *target_position;
    __global const uchar *disoccluded, *is_dynamic;
    __global half *color;
    __global float *depth;
    __global float2 *motion;
    __global uchar *filled_by;
    TOLD
} Movers;

INLINE int reach_of(__constant Frame *frame) { return max(MOVER_REACH, frame->target_width / MOVER_REACH_SHARE); }

/* The position where the pixel (dst_x, dst_y) was in the rendered image if it moves as the mover at (x, y) does. */
INLINE float2 moves_along(const int x, const int y, const int dst_x, const int dst_y, __constant Frame *frame,
                          const Movers f) {
    return pixel_center(x, y) + f.motion[y * frame->target_width + x]
           + (float2)(divide((float)(dst_x - x), frame->zoom.x), divide((float)(dst_y - y), frame->zoom.y));
}

/* Whether the frame before showed something farther than the mover at (x, y) where its part at px_source of the
   rendered image, at depth z_source, was then: the mover has no part there. */
INLINE bool was_seen_through(const int x, const int y, const float2 px_source, const float z_source,
                             __constant Frame *frame, const Movers f) {
    const int width = frame->source_width, height = frame->source_height;
    const float2 px_mover = moves_along(x, y, x, y, frame, f);
    const int src_x = clamp((int)px_mover.x, 0, width - 1), src_y = clamp((int)px_mover.y, 0, height - 1);
    const float2 px_prev = px_source + f.source_motion[src_y * width + src_x];
    if (!frame->has_previous || !holds(width, height, px_prev)) return false;
    const float z_prev = f.depth_prev[(int)px_prev.y * width + (int)px_prev.x];
    const float z_expected = reproject(px_source, z_source, frame->to_previous).z;
    TELL(f, PREV_X, px_prev.x);
    TELL(f, PREV_Y, px_prev.y);
    TELL(f, PREV_Z, z_prev);
    TELL(f, PART_PREV_Z, z_expected);
    return HIDES * z_prev > z_expected;
}

/* Steps to the first mover in direction d, behind the surfaces before it, a part of which may have been hidden here;
   0: none. */
INLINE int steps_to_mover(const int dst_x, const int dst_y, const int2 d, __constant Frame *frame, const Movers f) {
    const int width = frame->target_width, height = frame->target_height;
    const int dst = dst_y * width + dst_x, offset = d.y * width + d.x;
    const int steps = steps_within(reach_of(frame), d, dst_x, dst_y, width, height);
    const int t = first_other(dst, offset, steps, f.is_dynamic, 0);
    if (t == 0) return 0;
    const float z = f.depth[dst + t * offset];
    TELL(f, STEPS, t);
    TELL(f, MOVER_Z, z);
    TELL(f, REFUSED_BY, SURFACE_BETWEEN);
    for (int first = 1; first < t; first += AT_ONCE) {
        uint shown = others_from(first, t - 1, dst, offset, f.disoccluded, 1);
        for (; shown; shown &= shown - 1) {
            const float z_between = f.depth[dst + min(first + first_of(shown), t - 1) * offset];
            TELL(f, BETWEEN_Z, z_between);
            if (!(z_between < z * NEARER)) return 0;
        }
    }
    const int x = dst_x + t * d.x, y = dst_y + t * d.y;
    const float2 px_source = moves_along(x, y, dst_x, dst_y, frame, f);
    TELL(f, PLACE_X, px_source.x);
    TELL(f, PLACE_Y, px_source.y);
    TELL(f, REFUSED_BY, OUT_OF_FRAME);
    if (!holds(frame->source_width, frame->source_height, px_source)) return 0;
    const float z_shown = f.source_depth[(int)px_source.y * frame->source_width + (int)px_source.x];
    const float z_source = reproject(pixel_center(x, y), z, frame->to_source).z;
    TELL(f, SHOWN_Z, z_shown);
    TELL(f, PART_Z, z_source);
    TELL(f, REFUSED_BY, NOT_HIDDEN);
    if (!INVALID_DEPTH(z_shown) && !(z_shown < HIDES * z_source)) return 0;
    const bool seen_through = was_seen_through(x, y, px_source, z_source, frame, f);
    TELL(f, REFUSED_BY, seen_through ? SEEN_THROUGH : NOT_REFUSED);
    return seen_through ? 0 : t;
}

/* A direction from a hole: steps to the mover there, 0 if there is none, and what it gives to the hole's mean. */
typedef struct {
    int steps;
    float z, weight, code_x, code_y, code_z, px_x, px_y;
} MoverSide;

INLINE MoverSide look_for_mover(const int dst_x, const int dst_y, const int2 d, __constant Frame *frame,
                                const Movers f) {
    const MoverSide none = {0, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    const int steps = steps_to_mover(dst_x, dst_y, d, frame, f);
    if (steps == 0) return none;
    const int x = dst_x + steps * d.x, y = dst_y + steps * d.y, there = y * frame->target_width + x;
    const float3 code = load_code(f.color, there, frame->code_offset);
    const float2 px = moves_along(x, y, dst_x, dst_y, frame, f);
    const float weight = divide(1.0f, (float)steps * step_length(d));
    const MoverSide side = {steps, f.depth[there], weight, code.x, code.y, code.z, px.x, px.y};
    return side;
}

/* Whether the mover on that side of a hole is BREADTH times as broad there, and far behind what hides it. */
INLINE bool is_broad(const int dst_x, const int dst_y, const int2 d, const MoverSide side, __constant Frame *frame,
                     const Movers f) {
    const int width = frame->target_width, far = (1 + BREADTH) * side.steps;
    const int x = dst_x + far * d.x, y = dst_y + far * d.y;
    if (!inside(x, y, width, frame->target_height) || !f.is_dynamic[y * width + x]) return false;
    const float z_shown = f.source_depth[(int)side.px_y * frame->source_width + (int)side.px_x];
    return z_shown > 0.0f && z_shown < FAR_BEHIND * side.z;
}

/* The direction in which the mover lies that the hole belongs to, which is close by or broad; -1: none. */
INLINE int owner(const int dst_x, const int dst_y, __local const MoverSide *sides, __constant Frame *frame,
                 const Movers f) {
    int nearest = -1;
    float least = INFINITY;
    for (int k = 0; k < DIRECTIONS; ++k) {
        const float distance = (float)sides[k].steps * step_length(direction(k));
        if (sides[k].steps == 0 || !(distance < least)) continue;
        least = distance;
        nearest = k;
    }
    if (nearest < 0 || least * (float)BESIDE <= (float)reach_of(frame)) return nearest;
    return is_broad(dst_x, dst_y, direction(nearest), sides[nearest], frame, f) ? nearest : -1;
}

/* Fills a hole with the mean of the mover that it belongs to around it, weighted by the inverse of distance. */
INLINE void fill_hidden_part(const int dst_x, const int dst_y, __local const MoverSide *sides, __constant Frame *frame,
                             const Movers f) {
    const int of = owner(dst_x, dst_y, sides, frame, f), dst = dst_y * frame->target_width + dst_x;
    if (of < 0) return;
    const float z_owner = sides[of].z;
    float3 sum = (float3)(0.0f);
    float2 px_sum = (float2)(0.0f);
    float z_sum = 0.0f, weight_sum = 0.0f;
    for (int k = 0; k < DIRECTIONS; ++k) {
        const MoverSide s = sides[k];
        if (s.steps == 0 || !(fabs(s.z - z_owner) <= ONE_OBJECT * z_owner)) continue;
        sum += s.weight * (float3)(s.code_x, s.code_y, s.code_z);
        px_sum += s.weight * (float2)(s.px_x, s.px_y);
        z_sum += s.weight * s.z;
        weight_sum += s.weight;
    }
    store_code(mean_of(sum, weight_sum), f.color, dst, frame->code_offset);
    f.depth[dst] = divide(z_sum, weight_sum);
    f.motion[dst] = (float2)(divide(px_sum.x, weight_sum), divide(px_sum.y, weight_sum)) - pixel_center(dst_x, dst_y);
    f.filled_by[dst] = BY_HIDDEN_PART;
}

/* The pixel of the rendered image that holds `place` or, outside of it, the one at its border beside. */
INLINE int pixel_beside(const float2 place, const int width, const int height) {
    return (int)fmin(fmax(place.y, 0.0f), (float)(height - 1)) * width
           + (int)fmin(fmax(place.x, 0.0f), (float)(width - 1));
}

/* Fills a hole at px with the mover at `beside`, the border of the rendered image, if it enters there: if the hole's
   place, moving as that mover does, is beyond the border. Its color is the border's. Returns whether it does. */
INLINE bool fill_from_border(const float2 beside, const float2 px, const int dst, __constant Frame *frame,
                             const Movers f) {
    const int width = frame->source_width, height = frame->source_height;
    float2 place = beside;
    float z = 0.0f;
    for (int k = 0; k < 2; ++k) { /* again from where along the border that came from */
        const int src = pixel_beside(place, width, height);
        const float3 there = position_of(f.target_position, src, width * height);
        if (!f.dynamic_mask[src] || !(there.z > 0.0f)) return false;
        place = pixel_center(src % width, src / width)
                + (float2)(divide(px.x - there.x, frame->zoom.x), divide(px.y - there.y, frame->zoom.y));
        z = there.z;
    }
    const int src = pixel_beside(place, width, height);
    if (!f.dynamic_mask[src] || holds(width, height, place)) return false;
    store_color(load_color(f.source_color, src), f.color, dst);
    f.depth[dst] = z;
    f.motion[dst] = place - px;
    f.filled_by[dst] = BY_HIDDEN_PART;
    return true;
}

/* Fills a hole with a mover that enters through the border close to it or, in a corner, through the other one. Returns
   whether there is one. */
INLINE bool fill_entering(const int dst_x, const int dst_y, __constant Frame *frame, const Movers f) {
    const int width = frame->target_width, height = frame->target_height, dst = dst_y * width + dst_x;
    if (!frame->entering) return false;
    const float2 px = pixel_center(dst_x, dst_y),
                 place = (float2)(divide(px.x, frame->zoom.x), divide(px.y, frame->zoom.y));
    const float2 across = (float2)(2 * dst_x < width ? 0.0f : (float)frame->source_width, place.y),
                 upright = (float2)(place.x, 2 * dst_y < height ? 0.0f : (float)frame->source_height);
    const bool is_across = min(dst_x, width - 1 - dst_x) <= min(dst_y, height - 1 - dst_y);
    return fill_from_border(is_across ? across : upright, px, dst, frame, f)
           || fill_from_border(is_across ? upright : across, px, dst, frame, f);
}

/* ---- parts that reappear ----------------------------------------------------------------------------------------- */

#define SIDES 4         /* in which movers have parts behind what is nearer: those of the bits of `links` */
#define COVERS 0.5f     /* source px: a part covers target pixels up to so far from it */
#define LEAST_APART 0.25f /* source px: what moves less against what hides it does not come out */
#define SAME_PART 0.025f /* relative depth in the frame before within which a surface is the mover's */
#define EMPTY_KEYS 2    /* a pass, before those of nearest.h: sets keys free that parts may be offered to */

/* The rendered frame, the depth of the one before it and of the new one, and what is offered to the pixels of this;
   `offered` lists them. */
typedef struct {
    __global const float *depth, *depth_prev, *met_depth, *target_position, *shown_depth;
    __global const float2 *motion;
    __global const uchar *dynamic_mask, *links;
    __global Key *keys;
    __global uint *winners, *offered;
    __global uchar *filled_by;
} Parts;

/* Where a part that covers target pixel (dst_x, dst_y) is in the rendered image, if it moves like its mover at (x, y)
   there, which goes to `there`. */
INLINE float2 place_of_part(const int x, const int y, const int dst_x, const int dst_y, const float3 there,
                            __constant Frame *frame) {
    const float2 off = pixel_center(dst_x, dst_y) - there.xy;
    return pixel_center(x, y) + (float2)(divide(off.x, frame->zoom.x), divide(off.y, frame->zoom.y));
}

/* Whether pixel `src` of the rendered frame shows something else that is nearer than `z`. */
INLINE bool is_hidden(const int src, const float z, const Parts f) {
    return f.depth[src] > 0.0f && f.depth[src] < (f.dynamic_mask[src] == STATIC ? HIDES : MOVER_HIDES) * z;
}

/* Whether the frame before showed a mover of depth `met` at px_prev: a surface of that depth. */
INLINE bool mover_was_shown(const float2 px_prev, const float met, __constant Frame *frame, const Parts f) {
    const int width = frame->source_width, height = frame->source_height;
    if (!holds(width, height, px_prev)) return false;
    return fabs(f.depth_prev[(int)px_prev.y * width + (int)px_prev.x] - met) <= SAME_PART * met;
}

/* Offers the parts of the mover at (src_x, src_y) on side k of it, where something nearer hides them; its
   pixel beside the mover does. */
INLINE void offer_side(const int src_x, const int src_y, const int k, const int pass, __constant Frame *frame,
                       const Parts f) {
    const int width = frame->source_width, height = frame->source_height, target_width = frame->target_width;
    const int src = src_y * width + src_x, plane = width * height;
    const int2 d = direction(2 * k);
    const float2 zoom = frame->zoom, mv = f.motion[src];
    const float z = f.depth[src], met = f.met_depth[src];
    const float3 there = position_of(f.target_position, src, plane);
    if (!(met > 0.0f && there.z > 0.0f && fabs(there.x) < 2.0f * (float)target_width)
        || !(fabs(there.y) < 2.0f * (float)frame->target_height))
        return;
    const float half_x = fmax(COVERS * zoom.x, 0.5f), half_y = fmax(COVERS * zoom.y, 0.5f);
    const int offset = d.y * width + d.x, steps = steps_within(reach_of(frame), d, src_x, src_y, width, height);
    const float3 beside = position_of(f.target_position, src + offset, plane);
    const float apart = d.x ? divide((there.x - beside.x) * (float)d.x, zoom.x) + 1.0f
                            : divide((there.y - beside.y) * (float)d.y, zoom.y) + 1.0f;
    if (!(fabs(apart) > LEAST_APART && fabs(apart) < (float)width)) return;
    int end = 2;
    while (end <= steps && is_hidden(src + end * offset, z, f)) ++end;
    const int some = (int)fabs(apart) + 2; /* parts at that end which can come out */
    const int last = apart > 0.0f ? end - 1 : min(end - 1, some);
    for (int t = apart > 0.0f ? max(end - some, 1) : 1; t <= last; ++t) {
        const float x = there.x + (float)(t * d.x) * zoom.x, y = there.y + (float)(t * d.y) * zoom.y;
        const int x1 = min((int)floor(x + half_x - 0.5f), target_width - 1);
        const int y1 = min((int)floor(y + half_y - 0.5f), frame->target_height - 1);
        for (int dst_y = max((int)ceil(y - half_y - 0.5f), 0); dst_y <= y1; ++dst_y)
            for (int dst_x = max((int)ceil(x - half_x - 0.5f), 0); dst_x <= x1; ++dst_x) {
                const int dst = dst_y * target_width + dst_x;
                if (pass == EMPTY_KEYS) forget(f.keys, f.winners, dst);
                if (pass == EMPTY_KEYS || !(there.z < HIDES * f.shown_depth[dst])) continue;
                const float2 place = place_of_part(src_x, src_y, dst_x, dst_y, there, frame);
                if (!holds(width, height, place) || !is_hidden((int)place.y * width + (int)place.x, z, f)
                    || !mover_was_shown(place + mv, met, frame, f))
                    continue;
                if (!offer(pass, f.keys, f.winners, dst, there.z, (uint)src)) continue;
                f.filled_by[dst] = BY_REAPPEARING;
                append((uint)dst, f.offered);
            }
    }
}

/* Whether something nearer hides what is beside a mover's pixel, on side k. */
INLINE bool is_hidden_beside(const int src, const int k, __constant Frame *frame, const Parts f) {
    const int width = frame->source_width, src_x = src % width, src_y = src / width;
    const int2 d = direction(2 * k);
    return !(f.links[src] >> k & 1) && inside(src_x + d.x, src_y + d.y, width, frame->source_height)
           && is_hidden(src + d.y * width + d.x, f.depth[src], f);
}

/* Offers parts, or empties the keys for them, at the edges of movers that something hides, of those that the work-group
   scans, one side per work-item, if it is `wanted` and there is a frame before. All work-items must come here: PoCL
   skips tests of single ones behind a barrier that is in a branch. `found`, `found_count`: as for scan_for. */
INLINE void offer_at_edges(const bool wanted, const int pass, __constant Frame *frame, const Parts f,
                           __local ushort *found, __local uint *found_count) {
    const int width = frame->source_width;
    const int end = wanted && frame->has_previous ? width * frame->source_height : 0;
    const int first = scan_for(DYNAMIC, f.dynamic_mask, end, found, found_count);
    for (uint i = get_local_id(0); i < SIDES * *found_count; i += SCAN_GROUP) {
        const int src = first + found[i / SIDES], k = (int)i % SIDES;
        if (is_hidden_beside(src, k, frame, f)) offer_side(src % width, src / width, k, pass, frame, f);
    }
}

/* Fills the open pixels, a team of work-items for each. If parts `reappear`, empties the keys that they
   will be offered to, which nothing else here reads, and the list of where. */
SCAN_FLAT __kernel void fill_hidden_parts(__constant Frame *restrict frame, const int reappear,
                                          __global const float *source_depth, __global const float2 *source_motion,
                                          __global const half *source_color, __global const float *depth_prev,
                                          __global const uint *open, __global const uchar *disoccluded,
                                          __global const uchar *is_dynamic, __global half *color, __global float *depth,
                                          __global float2 *motion, __global uchar *filled_by,
                                          __global const uchar *dynamic_mask, __global const uchar *links,
                                          __global const float *met_depth, __global const float *target_position,
                                          __global Key *keys, __global uint *winners, __global uint *offered) {
    __local MoverSide sides[TEAMS][DIRECTIONS];
    __local ushort found[SCAN_GROUP * SCAN_BYTES];
    __local uint found_count;
    const Movers images = {source_depth, depth_prev, source_motion, source_color, dynamic_mask, target_position,
                           disoccluded,  is_dynamic, color,         depth,        motion,       filled_by};
    const Parts parts = {source_depth, depth_prev, met_depth, target_position, depth,   source_motion,
                         dynamic_mask, links,      keys,      winners,         offered, filled_by};
    const int width = frame->target_width, item = get_local_id(0), team = item / TEAM;
    offer_at_edges(reappear, EMPTY_KEYS, frame, parts, found, &found_count);
    if (reappear && get_global_id(0) == 0) offered[0] = 0;
    for (uint first = get_group_id(0) * TEAMS; first < open[0]; first += get_num_groups(0) * TEAMS) {
        /* Team by team look into all directions ... */
        const uint hole = entry_of(open, first + team);
        for (int k = item % TEAM; hole != NO_ENTRY && k < DIRECTIONS; k += TEAM)
            sides[team][k] = look_for_mover((int)hole % width, (int)hole / width, direction(k), frame, images);
        WAIT_FOR_TEAM();

        /* ... and one work-item fills a hole. */
        const uint own = item < TEAMS ? entry_of(open, first + item) : NO_ENTRY;
        const int dst_x = (int)own % width, dst_y = (int)own / width;
        if (own != NO_ENTRY && !fill_entering(dst_x, dst_y, frame, images))
            fill_hidden_part(dst_x, dst_y, sides[item], frame, images);
        WAIT_FOR_TEAM();
    }
}

/* Offers the parts of movers that reappear. Lists where. */
SCAN_FLAT __kernel void offer_reappearing(__constant Frame *restrict frame, const int pass, __global const float *depth,
                                          __global const float2 *motion, __global const uchar *dynamic_mask,
                                          __global const uchar *links, __global const float *met_depth,
                                          __global const float *target_position, __global const float *depth_prev,
                                          __global const float *shown_depth, __global Key *keys, __global uint *winners,
                                          __global uchar *filled_by, __global uint *offered) {
    __local ushort found[SCAN_GROUP * SCAN_BYTES];
    __local uint found_count;
    const Parts parts = {depth,        depth_prev, met_depth, target_position, shown_depth, motion,
                         dynamic_mask, links,      keys,      winners,         offered,     filled_by};
    offer_at_edges(true, pass, frame, parts, found, &found_count);
}

/* Fills the pixels that parts were offered to, with the color that the frame before showed there. */
WALK __kernel void fill_reappearing(__constant Frame *restrict frame, __global const float2 *source_motion,
                                    __global const float *target_position, __global const half *color_prev,
                                    __global const Key *keys, __global const uint *winners, __global half *color,
                                    __global float *depth, __global float2 *motion, __global uchar *is_dynamic,
                                    __global const uint *offered) {
    const int source_width = frame->source_width, target_width = frame->target_width;
    const int plane = source_width * frame->source_height;
    for (uint i = get_global_id(0); i < offered[0]; i += get_global_size(0)) {
        const int dst = (int)LISTED(offered, i), dst_x = dst % target_width, dst_y = dst / target_width;
        const int src = (int)winner_of(keys, winners, dst);
        const float3 there = position_of(target_position, src, plane);
        const float2 place = place_of_part(src % source_width, src / source_width, dst_x, dst_y, there, frame);
        const float2 px_prev = place + source_motion[src];
        store_color(load_color(color_prev, (int)px_prev.y * source_width + (int)px_prev.x), color, dst);
        depth[dst] = there.z;
        motion[dst] = place - pixel_center(dst_x, dst_y);
        is_dynamic[dst] = DYNAMIC;
    }
}
