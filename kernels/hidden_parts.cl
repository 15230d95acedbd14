/* Hidden parts of movers: disocclusions that belong to a moving object, not to the static background. A mover's part
   in a disocclusion moves like the dynamic fragments next to it, so its place in the rendered frame is known. The
   warp brought nothing from there, so the part was hidden, or its depth is invalid. Where that frame shows a surface
   there that is not nearer, the mover has no part there, and the hole is left to the background; so it is where the
   frame before showed something farther where that part was then. A mover that enters through the border of the image
   has parts that no frame has shown: it is continued to that border. RUN pixels without a hole are skipped at once, and
   so are RUN x LANES without a dynamic pixel within reach.

   A part that the frame before showed, and that a nearer static surface hides in the rendered frame, reappears: it
   comes out before surfaces that are shown, or in a hole. It moves like the mover beside what hides it, and has the
   color that it had. */

#include "frame.h"
#include "simd.h"
#include "nearest.h"
#include "color_code.h"
#include "directional_search.h"
#include "blocks.h"
#include "flow.h"

#define ONE_OBJECT 0.05f  /* relative depth within which two dynamic fragments are of one object ... */
#define HIDES 0.95f       /* ... and times the depth of a mover: nearer surfaces are others, and may hide it */
/* STANDS_BEFORE: times the depth of a mover: its parts are looked for behind static pixels nearer than that */
#define STANDS_BEFORE 0.97f
#define BESIDE 3          /* a mover that is nearer than this part of the reach need not be on both sides */

#define LEAST_REACH 8     /* px, in which movers are looked for ... */
#define REACH_SHARE 48    /* ... or this part of the target's width */
#define BORDER_SHARE 8    /* part of the target's width: holes no wider may be those of movers that enter */

/* The new frame, the depth of the rendered one and of the one before it, and the motion between these. */
typedef struct {
    __global const float *source_depth, *depth_prev;
    __global const float2 *source_motion;
    __global const uchar *disoccluded, *is_dynamic;
    __global half *color;
    __global float *depth;
    __global float2 *motion;
    __global uchar *filled_by;
} Images;

INLINE int reach_of(__constant Frame *frame) { return max(LEAST_REACH, frame->target_width / REACH_SHARE); }

/* The position where the pixel (dst_x, dst_y) was in the rendered image if it moves as the mover at (x, y) does. */
INLINE float2 moves_along(const int x, const int y, const int dst_x, const int dst_y, __constant Frame *frame,
                          const Images f) {
    return pixel_center(x, y) + f.motion[y * frame->target_width + x]
           + (float2)(divide((float)(dst_x - x), frame->zoom.x), divide((float)(dst_y - y), frame->zoom.y));
}

/* The first of `steps` pixels, `offset` apart from each other, that is dynamic, counted from 1; 0: none. */
INLINE int first_dynamic(const int dst, const int offset, const int steps, __global const uchar *is_dynamic) {
    int t = 1;
    for (; t + AT_ONCE <= steps; t += AT_ONCE) {
        uchar any = 0;
        for (int k = 0; k < AT_ONCE; ++k) any |= is_dynamic[dst + (t + k) * offset];
        if (any) break;
    }
    for (; t <= steps; ++t)
        if (is_dynamic[dst + t * offset]) return t;
    return 0;
}

/* Whether the frame before showed something farther than the mover at (x, y) where its part at px_source of the
   rendered image, at depth z_source, was then: the mover has no part there. */
INLINE bool was_seen_through(const int x, const int y, const float2 px_source, const float z_source,
                             __constant Frame *frame, const Images f) {
    const int width = frame->source_width, height = frame->source_height;
    const float2 px_mover = moves_along(x, y, x, y, frame, f);
    const int src_x = clamp((int)px_mover.x, 0, width - 1), src_y = clamp((int)px_mover.y, 0, height - 1);
    const float2 px_prev = px_source + f.source_motion[src_y * width + src_x];
    if (!frame->has_previous || !holds(width, height, px_prev)) return false;
    const float z_prev = f.depth_prev[(int)px_prev.y * width + (int)px_prev.x];
    return HIDES * z_prev > reproject(px_source, z_source, frame->to_previous).z;
}

/* Steps to the first mover in direction d, behind the surfaces before it, a part of which may have been hidden here;
   0: none. */
INLINE int steps_to_mover(const int dst_x, const int dst_y, const int2 d, __constant Frame *frame, const Images f) {
    const int width = frame->target_width, height = frame->target_height;
    const int dst = dst_y * width + dst_x, offset = d.y * width + d.x;
    const int t =
        first_dynamic(dst, offset, steps_within(reach_of(frame), d, dst_x, dst_y, width, height), f.is_dynamic);
    if (t == 0) return 0;
    const float z = f.depth[dst + t * offset];
    for (int k = 1; k < t; ++k) {
        const int between = dst + k * offset;
        if (!f.disoccluded[between] && !(f.depth[between] < z * STANDS_BEFORE)) return 0;
    }
    const int x = dst_x + t * d.x, y = dst_y + t * d.y;
    const float2 px_source = moves_along(x, y, dst_x, dst_y, frame, f);
    if (!holds(frame->source_width, frame->source_height, px_source)) return 0;
    const float z_shown = f.source_depth[(int)px_source.y * frame->source_width + (int)px_source.x];
    const float z_source = reproject(pixel_center(x, y), z, frame->to_source).z;
    if (!INVALID_DEPTH(z_shown) && !(z_shown < HIDES * z_source)) return 0;
    return was_seen_through(x, y, px_source, z_source, frame, f) ? 0 : t;
}

/* The direction, of those with `t` steps to a mover, in which the mover lies that the hole belongs to: one close by,
   or else the nearest that is on both sides; -1: none. */
INLINE int owner(const DirectionInts t, const DirectionFloats z, const int reach) {
    int nearest = -1, between = -1;
    float least = INFINITY, least_between = INFINITY;
#pragma unroll
    for (int k = 0; k < DIRECTIONS; ++k) {
        const float step = step_length(direction(k)), distance = (float)AT(t, k) * step;
        const int other = (k + 4) & 7;
        if (AT(t, k) == 0) continue;
        if (distance < least) {
            least = distance;
            nearest = k;
        }
        if (AT(t, other) && (float)(AT(t, k) + AT(t, other)) * step <= (float)reach && distance < least_between
            && fabs(AT(z, k) - AT(z, other)) <= ONE_OBJECT * fmin(AT(z, k), AT(z, other))) {
            least_between = distance;
            between = k;
        }
    }
    return least * (float)BESIDE <= (float)reach ? nearest : between;
}

/* Fills a hole with the mean of the mover that it belongs to around it, weighted by the inverse of distance. */
INLINE void fill_hidden_part(const int dst_x, const int dst_y, __constant Frame *frame, const Images f) {
    const int width = frame->target_width, dst = dst_y * width + dst_x;
    DirectionInts t;
    DirectionFloats z;
    for (int k = 0; k < DIRECTIONS; ++k) {
        const int2 d = direction(k);
        const int steps = steps_to_mover(dst_x, dst_y, d, frame, f);
        const float z_mover = steps ? f.depth[dst + steps * (d.y * width + d.x)] : 0.0f;
        SET(t, k, steps);
        SET(z, k, z_mover);
    }
    const int of = owner(t, z, reach_of(frame));
    if (of < 0) return;
    const float z_owner = AT(z, of);
    float3 sum = (float3)(0.0f);
    float2 px_sum = (float2)(0.0f);
    float z_sum = 0.0f, weight_sum = 0.0f;
    for (int k = 0; k < DIRECTIONS; ++k) {
        const int steps = AT(t, k);
        const float z_mover = AT(z, k);
        if (steps == 0 || !(fabs(z_mover - z_owner) <= ONE_OBJECT * z_owner)) continue;
        const int2 d = direction(k);
        const int x = dst_x + steps * d.x, y = dst_y + steps * d.y;
        const float weight = divide(1.0f, (float)steps * step_length(d));
        sum += weight * load_code(f.color, y * width + x, frame->code_offset);
        px_sum += weight * moves_along(x, y, dst_x, dst_y, frame, f);
        z_sum += weight * z_mover;
        weight_sum += weight;
    }
    store_code(mean_of(sum, weight_sum), f.color, dst, frame->code_offset);
    f.depth[dst] = divide(z_sum, weight_sum);
    f.motion[dst] = (float2)(divide(px_sum.x, weight_sum), divide(px_sum.y, weight_sum)) - pixel_center(dst_x, dst_y);
    f.filled_by[dst] = BY_HIDDEN_PART;
}

INLINE int border_reach(__constant Frame *frame) { return frame->target_width / BORDER_SHARE; }

/* Fills a hole at the border with the mover that follows straight inward, if that one came from outside of the rendered
   image there. */
INLINE void fill_entering(const int dst_x, const int dst_y, __constant Frame *frame, const Images f) {
    const int width = frame->target_width, height = frame->target_height, dst = dst_y * width + dst_x;
    const int from_x = min(dst_x, width - 1 - dst_x), from_y = min(dst_y, height - 1 - dst_y);
    const int2 d = from_x <= from_y ? (int2)(2 * dst_x < width ? 1 : -1, 0) : (int2)(0, 2 * dst_y < height ? 1 : -1);
    const int offset = d.y * width + d.x, reach = border_reach(frame);
    const int most = steps_within(reach, d, dst_x, dst_y, width, height);
    if (min(from_x, from_y) >= reach) return;
    int t = 1;
    while (t <= most && f.disoccluded[dst + t * offset]) ++t;
    if (t > most || !f.is_dynamic[dst + t * offset]) return;
    const float2 px_source = moves_along(dst_x + t * d.x, dst_y + t * d.y, dst_x, dst_y, frame, f);
    const float along = d.x ? px_source.x : px_source.y;
    const float end = (float)(d.x ? frame->source_width : frame->source_height);
    if (d.x + d.y > 0 ? !(along < 0.0f) : !(along >= end)) return;
    store_code(load_code(f.color, dst + t * offset, frame->code_offset), f.color, dst, frame->code_offset);
    f.depth[dst] = f.depth[dst + t * offset];
    f.motion[dst] = px_source - pixel_center(dst_x, dst_y);
    f.filled_by[dst] = BY_HIDDEN_PART;
}

/* Whether nothing within `reach` of RUN pixels in the rows from first_y to last_y is dynamic. */
INLINE bool nothing_moves(const int first_x, const int first_y, const int last_y, const int reach, const int width,
                          const int height, __global const uchar *is_dynamic) {
    if (RUN == 1 || width < RUN) return false; /* pixel by pixel that takes longer than to look in eight directions */
    const int x0 = max(first_x - reach, 0), x1 = min(first_x + RUN + reach, width);
    for (int y = max(first_y - reach, 0); y <= min(last_y + reach, height - 1); ++y)
        for (int x = x0; x < x1; x += RUN)
            if (!run_is_zero(is_dynamic + y * width + min(x, width - RUN))) return false;
    return true;
}

/* RUN x LANES pixels per work-item. */
SCAN __kernel void fill_hidden_parts(__constant Frame *restrict frame, __global const float *source_depth,
                                     __global const float2 *source_motion, __global const float *depth_prev,
                                     __global const uchar *block_class, __global const uchar *disoccluded,
                                     __global const uchar *is_dynamic, __global half *color, __global float *depth,
                                     __global float2 *motion, __global uchar *filled_by) {
    const Images images = {.source_depth = source_depth,
                           .depth_prev = depth_prev,
                           .source_motion = source_motion,
                           .disoccluded = disoccluded,
                           .is_dynamic = is_dynamic,
                           .color = color,
                           .depth = depth,
                           .motion = motion,
                           .filled_by = filled_by};
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int first_x = get_global_id(0) * RUN, end_y = min((int)(get_global_id(1) + 1) * LANES, target_height);
    if (first_x >= target_width || (int)get_global_id(1) * LANES >= target_height) return;
    const int near = border_reach(frame);
    bool looked = false, moves = false;
    for (int dst_y = (int)get_global_id(1) * LANES; dst_y < end_y; ++dst_y) {
        if (run_is_backward(first_x, dst_y, target_width, block_class)) continue;
        const int first = dst_y * target_width + first_x;
        if (first_x + RUN <= target_width && run_is_zero(disoccluded + first)) continue;
        if (!looked)
            moves = !nothing_moves(first_x, dst_y, end_y - 1, reach_of(frame), target_width, target_height, is_dynamic);
        looked = true;
        const bool at_border =
            frame->entering
            && (first_x < near || first_x + RUN > target_width - near || dst_y < near || dst_y >= target_height - near);
        const int end_x = min(first_x + RUN, target_width);
        for (int dst_x = first_x; at_border && dst_x < end_x; ++dst_x)
            if (disoccluded[dst_y * target_width + dst_x]) fill_entering(dst_x, dst_y, frame, images);
        for (int dst_x = first_x; moves && dst_x < end_x; ++dst_x) {
            const int dst = dst_y * target_width + dst_x;
            if (disoccluded[dst] && filled_by[dst] != BY_HIDDEN_PART) fill_hidden_part(dst_x, dst_y, frame, images);
        }
    }
}

/* ---- parts that reappear ----------------------------------------------------------------------------------------- */

#define SIDES 4         /* in which movers have parts behind what is nearer: those of the bits of `links` */
#define COVERS 0.5f     /* source px: a part covers target pixels up to so far from it */
#define LEAST_APART 0.25f /* source px: what moves less against what hides it does not come out */
#define SAME_PART 0.025f /* relative depth in the frame before within which a surface is the mover's */
#define STAYS 0.02f     /* relative depth within which a static point of the frame before is still there */
#define EMPTY_KEYS 2    /* a pass, before those of nearest.h: sets keys free that parts may be offered to */

/* The rendered frame, the frame before it, and the new one. */
typedef struct {
    __global const float *depth, *depth_prev, *met_depth, *target_position;
    __global const float2 *motion;
    __global const uchar *dynamic_mask, *links;
    __global const half *color_prev;
    __global const float *shown_depth;
    __global Key *keys;
    __global uint *winners;
    __global uchar *filled_by;
} Parts;

INLINE int2 side(const int k) { return k & 1 ? (int2)(0, 2 - k) : (int2)(1 - k, 0); }

/* Where a part that covers target pixel (dst_x, dst_y) is in the rendered image, if it moves like its mover at (x, y)
   there, which goes to `there`. */
INLINE float2 place_of_part(const int x, const int y, const int dst_x, const int dst_y, const float3 there,
                            __constant Frame *frame) {
    const float2 off = pixel_center(dst_x, dst_y) - there.xy;
    return pixel_center(x, y) + (float2)(divide(off.x, frame->zoom.x), divide(off.y, frame->zoom.y));
}

/* Whether something static and nearer than `z` is shown at pixel `src` of the rendered frame. */
INLINE bool is_hidden(const int src, const float z, const Parts f) {
    return f.dynamic_mask[src] == STATIC && f.depth[src] > 0.0f && f.depth[src] < HIDES * z;
}

/* Whether the frame before showed a mover of depth `met` at px_prev: a surface of that depth that does not stay. */
INLINE bool mover_was_shown(const float2 px_prev, const float met, __constant Frame *frame, const Parts f) {
    const int width = frame->source_width, height = frame->source_height;
    if (!holds(width, height, px_prev)) return false;
    const int prev_x = (int)px_prev.x, prev_y = (int)px_prev.y;
    const float z = f.depth_prev[prev_y * width + prev_x];
    if (!(fabs(z - met) <= SAME_PART * met)) return false;
    const float3 now = reproject(pixel_center(prev_x, prev_y), z, frame->from_previous);
    if (!(now.z > 0.0f && holds(width, height, now.xy))) return true;
    const int src = (int)now.y * width + (int)now.x;
    return f.dynamic_mask[src] != STATIC || !(fabs(f.depth[src] - now.z) <= STAYS * now.z);
}

/* Offers the parts of the mover at (src_x, src_y) on side k of it, where something static and nearer hides them; its
   pixel beside the mover does. */
INLINE void offer_side(const int src_x, const int src_y, const int k, const int pass, __constant Frame *frame,
                       const Parts f) {
    const int width = frame->source_width, height = frame->source_height, target_width = frame->target_width;
    const int src = src_y * width + src_x, plane = width * height;
    const int2 d = side(k);
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
                if (!(there.z < HIDES * f.shown_depth[dst])) continue;
                if (pass == EMPTY_KEYS) {
                    forget(f.keys, f.winners, dst);
                    continue;
                }
                const float2 place = place_of_part(src_x, src_y, dst_x, dst_y, there, frame);
                if (!holds(width, height, place) || !is_hidden((int)place.y * width + (int)place.x, z, f)
                    || !mover_was_shown(place + mv, met, frame, f))
                    continue;
                offer(pass, f.keys, f.winners, dst, there.z, (uint)src);
                f.filled_by[dst] = BY_REAPPEARING;
            }
    }
}

/* Whether nothing moves in RUN x LANES pixels from (x, y) on, which are multiples of these. */
INLINE bool tile_is_static(const int x, const int y, __constant Frame *frame, __global const int *last_stir) {
    const int width = frame->source_width, last_x = min(x + RUN, width) - 1;
    if (RUN == 1) return false; /* a pixel's mask says so */
    for (int dy = 0; dy < min(LANES, frame->source_height - y); dy += BLOCK_HEIGHT)
        for (int block = block_of(x, y + dy, width); block <= block_of(last_x, y + dy, width); ++block)
            if (last_stir[block] == frame->number) return false;
    return true;
}

/* Whether RUN pixels hold a mover's edge. */
INLINE bool run_has_edge(__global const uchar *dynamic_mask, __global const uchar *links) {
#if RUN == 16
    return any((vload16(0, dynamic_mask) != (uchar16)(0)) & (vload16(0, links) != (uchar16)(ALL_LINKS)));
#else
    return *dynamic_mask != 0 && *links != ALL_LINKS;
#endif
}

/* Offers the parts of movers that reappear, RUN x LANES pixels of the rendered frame per work-item. Nothing changes but
   keys and labels. */
SCAN __kernel void offer_reappearing(__constant Frame *restrict frame, const int pass, __global const float *depth,
                                     __global const float2 *motion, __global const uchar *dynamic_mask,
                                     __global const uchar *links, __global const int *last_stir,
                                     __global const float *met_depth, __global const float *target_position,
                                     __global const float *depth_prev, __global const float *shown_depth,
                                     __global Key *keys, __global uint *winners, __global uchar *filled_by) {
    const int width = frame->source_width, height = frame->source_height;
    const int first_x = get_global_id(0) * RUN, first_y = get_global_id(1) * LANES;
    if (first_x >= width || first_y >= height || !frame->has_previous) return;
    if (tile_is_static(first_x, first_y, frame, last_stir)) return;
    const Parts parts = {.depth = depth,
                         .depth_prev = depth_prev,
                         .met_depth = met_depth,
                         .target_position = target_position,
                         .motion = motion,
                         .dynamic_mask = dynamic_mask,
                         .links = links,
                         .shown_depth = shown_depth,
                         .keys = keys,
                         .winners = winners,
                         .filled_by = filled_by};
    const int rows = LANES == 1 ? 1 : min(LANES, height - first_y); /* GPUs' compilers unroll that */
    for (int row = 0; row < rows; ++row) {
        const int src_y = first_y + row, first = src_y * width + first_x;
        if (first_x + RUN <= width
            && (run_is_zero(dynamic_mask + first) || !run_has_edge(dynamic_mask + first, links + first)))
            continue;
        for (int src_x = first_x; src_x < min(first_x + RUN, width); ++src_x) {
            const int src = src_y * width + src_x;
            if (dynamic_mask[src] != DYNAMIC || links[src] == ALL_LINKS) continue;
            for (int k = 0; k < SIDES; ++k) {
                const int2 d = side(k);
                if ((links[src] >> k & 1) || !inside(src_x + d.x, src_y + d.y, width, height)) continue;
                if (is_hidden(src + d.y * width + d.x, depth[src], parts))
                    offer_side(src_x, src_y, k, pass, frame, parts);
            }
        }
    }
}

/* Code of the color that a mover of depth `met` had at px_prev, where the frame before showed it. */
INLINE float3 code_before(const float2 px_prev, const float met, __constant Frame *frame, const Parts f) {
    const int width = frame->source_width, height = frame->source_height;
    const int x0 = (int)floor(px_prev.x - 0.5f), y0 = (int)floor(px_prev.y - 0.5f);
    const float u = px_prev.x - 0.5f - (float)x0, v = px_prev.y - 0.5f - (float)y0;
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int x = x0 + (tap & 1), y = y0 + (tap >> 1), i = y * width + x;
        if (!inside(x, y, width, height) || !(fabs(f.depth_prev[i] - met) <= SAME_PART * met)) continue;
        const float weight = bilinear_weight(tap, u, v);
        sum += weight * load_code(f.color_prev, i, frame->code_offset);
        weight_sum += weight;
    }
    return mean_of(sum, weight_sum);
}

/* Fills the pixels that parts were offered to, RUN x LANES per work-item. */
SCAN __kernel void fill_reappearing(__constant Frame *restrict frame, __global const float2 *source_motion,
                                    __global const float *met_depth, __global const float *target_position,
                                    __global const float *depth_prev, __global const half *color_prev,
                                    __global const Key *keys, __global const uint *winners, __global half *color,
                                    __global float *depth, __global float2 *motion, __global uchar *is_dynamic,
                                    __global const uchar *filled_by) {
    const int source_width = frame->source_width, target_width = frame->target_width;
    const int first_x = get_global_id(0) * RUN, first_y = get_global_id(1) * LANES;
    if (first_x >= target_width || first_y >= frame->target_height) return;
    const Parts parts = {.depth_prev = depth_prev, .color_prev = color_prev};
    const int plane = source_width * frame->source_height;
    const int rows = LANES == 1 ? 1 : min(LANES, frame->target_height - first_y);
    for (int row = 0; row < rows; ++row) {
        const int dst_y = first_y + row, first = dst_y * target_width + first_x;
        if (first_x + RUN <= target_width && !run_has(filled_by + first, BY_REAPPEARING)) continue;
        for (int dst_x = first_x; dst_x < min(first_x + RUN, target_width); ++dst_x) {
            const int dst = dst_y * target_width + dst_x;
            if (filled_by[dst] != BY_REAPPEARING) continue;
            const int src = (int)winner_of(keys, winners, dst);
            const float3 there = position_of(target_position, src, plane);
            const float2 place = place_of_part(src % source_width, src / source_width, dst_x, dst_y, there, frame);
            const float3 code = code_before(place + source_motion[src], met_depth[src], frame, parts);
            store_code(code, color, dst, frame->code_offset);
            depth[dst] = there.z;
            motion[dst] = place - pixel_center(dst_x, dst_y);
            is_dynamic[dst] = DYNAMIC;
        }
    }
}
