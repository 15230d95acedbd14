/* Parts of movers that the frame before showed, and that something nearer hides in the rendered frame, reappear: they
   come out before surfaces that are shown, or in holes. They move like the mover beside what hides them, and have the
   color that they had. hidden_parts.cl empties the keys that they are offered to, projection.cl offers and shows them.
 */

#include "frame.h"
#include "nearest.h"
#include "directional_search.h"
#include "flow.h"
#include "lists.h"

/* What set the thresholds: docs/deviations.md, "Hidden parts of movers", "Parts that the frame before showed
   reappear". */
#define HIDES 0.95f       /* times the depth of a mover: nearer surfaces are others, and may hide it ... */
#define MOVER_HIDES 0.8f  /* ... and movers so much nearer do, which are no limbs of its own */
#define MOVER_REACH 8     /* px, in which movers are looked for ... */
#define MOVER_REACH_SHARE 48    /* ... or this part of the target's width */
#define SIDES 4         /* in which movers have parts behind what is nearer: those of the bits of `links` */
#define COVERS 0.5f     /* source px: a part covers target pixels up to so far from it */
#define LEAST_APART 0.25f /* source px: what moves less against what hides it does not come out */
#define SAME_PART 0.025f /* relative depth in the frame before within which a surface is the mover's */
#define EMPTY_KEYS 2    /* a pass, before those of nearest.h: sets keys free that parts may be offered to */

INLINE int reach_of(__constant Frame *frame) { return max(MOVER_REACH, frame->target_width / MOVER_REACH_SHARE); }

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
