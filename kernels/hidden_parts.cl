/* Hidden parts of movers: disocclusions that belong to a moving object, not to the static background. A mover's part
   in a disocclusion moves like the dynamic fragments next to it, so its place in the rendered frame is known. The
   warp brought nothing from there, so the part was hidden, or its depth is invalid. Where that frame shows a surface
   there that is not nearer, the mover has no part there, and the hole is left to the background; so it is where the
   frame before showed something farther where that part was then. A mover that enters through the border of the image
   has parts that no frame has shown: it is continued to that border. RUN pixels without a hole are skipped at once, and
   so are RUN x LANES without a dynamic pixel within reach. */

#include "frame.h"
#include "simd.h"
#include "color_code.h"
#include "directional_search.h"
#include "blocks.h"

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

/* The position where the pixel `offset` away from (x, y) was in the rendered image if it moves as that one does. */
INLINE float2 moves_along(const int x, const int y, const int2 offset, __constant Frame *frame, const Images f) {
    return pixel_center(x, y) + f.motion[y * frame->target_width + x]
           + (float2)(divide((float)offset.x, frame->zoom.x), divide((float)offset.y, frame->zoom.y));
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
    const float2 px_mover = moves_along(x, y, (int2)(0, 0), frame, f);
    const int src_x = clamp((int)px_mover.x, 0, width - 1), src_y = clamp((int)px_mover.y, 0, height - 1);
    const float2 px_prev = px_source + f.source_motion[src_y * width + src_x];
    if (!frame->has_previous || !(px_prev.x >= 0.0f && px_prev.y >= 0.0f)
        || !(px_prev.x < (float)width && px_prev.y < (float)height))
        return false;
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
    const float2 px_source = moves_along(x, y, -t * d, frame, f);
    if (!(px_source.x >= 0.0f && px_source.y >= 0.0f && px_source.x < (float)frame->source_width
          && px_source.y < (float)frame->source_height))
        return 0;
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
        px_sum += weight * moves_along(x, y, -steps * d, frame, f);
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
    const float2 px_source = moves_along(dst_x + t * d.x, dst_y + t * d.y, -t * d, frame, f);
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
