/* Hidden parts of movers: disocclusions that belong to a moving object, not to the static background. A mover's part
   in a disocclusion moves like the dynamic fragments next to it, so its place in the rendered frame is known. The
   warp brought nothing from there, so the part was hidden, or its depth is invalid. Where that frame shows a surface
   there that is not nearer, the mover has no part there, and the hole is left to the background; so it is where the
   frame before showed something farther where that part was then. A mover at the border of the rendered image that
   enters has parts which no frame has shown: they have its color there. */

#include "frame.h"
#include "simd.h"
#include "nearest.h"
#include "color_code.h"
#include "directional_search.h"
#include "blocks.h"
#include "flow.h"
#include "lists.h"
#include "reappearing.h"
#include "thresholds.h"

/* What set the thresholds: docs/deviations.md, "Hidden parts of movers". */
#define ONE_OBJECT 0.05f  /* relative depth within which two dynamic fragments are of one object */
#define BESIDE 3          /* part of the reach within which a mover owns holes beside it, ... */
#define BREADTH 3         /* ... or times the way to it, if it is so broad and far behind what hides it: ... */
#define FAR_BEHIND 0.65f  /* ... by depth over depth */

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
    if (get_global_id(0) == 0) offered[0] = 0;
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
