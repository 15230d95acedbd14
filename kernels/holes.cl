/* Hole filling: pixels that are still invalid continue the surface behind the disocclusion or, out of screen, what is
   at the image's border; or they come from the image downsampled 32 times (paper: 'Shading correction network'). Only
   pixels labeled for filling change, and keep their label. */

#include "frame.h"
#include "far_side.h"
#include "lists.h"

/* What set the thresholds: docs/deviations.md, "Holes continue their far side", "Holes continue surfaces that can be
   there", "What lies beyond the image has no far side". */
#define LEAST_REACH 16 /* target px, in which the far side is looked for ... */
#define REACH_SHARE 10 /* ... or this part of the target's width */
#define DOWNSAMPLING 32
/* RENDERED_WEIGHT: of the rendered frame relative to valid pixels: it only counts without any of them */
#define RENDERED_WEIGHT 0.0009765625f

/* The new frame, of which holes are filled, and the rendered one. */
typedef struct {
    __global const uchar *filled_by;
    __global const half *codes; /* of its colors */
    __global const float *source_depth;
    __global const uchar *source_is_dynamic, *is_dynamic;
    __global half *color;
    __global float *depth;
    __global float2 *motion;
    TOLD
} Images;

/* Adds a pixel to the sums; those that are displayed bright weigh less, or one lamp would fill its whole texel. */
INLINE void add(float4 *sum, float *inverse_sum, const float pixel_weight, const float exposure, const float3 c,
                const float z) {
    const float weight = divide(pixel_weight, 1.0f + exposure * fmax(fmax(c.x, fmax(c.y, c.z)), 0.0f));
    *sum += weight * (float4)(c, 1.0f);
    *inverse_sum += weight * inverse_of(z);
}

/* ---- far side ------------------------------------------------------------------------------------------------ */

#define PAST_SHARE 4 /* part of the reach within which directions look past what they have met */
#define IN_FRONT 0.98f /* times the depth that is shown: nearer surfaces lie in front of it */
#define PAST_EDGE 2.0f /* steps in the rendered frame from the edge of a surface to what is behind it ... */
#define BEHIND_EDGE 0.25f /* which counts this much of what is beside the hole */

/* Where a static pixel is in the rendered image, and its depth there; z <= 0: behind the camera. */
INLINE float3 static_source(const int dst_x, const int dst_y, const float inverse_depth, const Reprojection to_source) {
    const float z = inverse_depth > 0.0f ? divide(1.0f, inverse_depth) : INFINITY;
    return reproject(pixel_center(dst_x, dst_y), z, to_source);
}

/* Code of the rendered frame's color at the place on its border that is closest to `px_source`, a place out of screen;
   linear between two pixels. */
INLINE float3 border_code(const float2 px_source, __constant Frame *frame, __global const half *codes) {
    const int width = frame->source_width, height = frame->source_height;
    const float x = clamp(px_source.x - 0.5f, 0.0f, (float)(width - 1)),
                y = clamp(px_source.y - 0.5f, 0.0f, (float)(height - 1));
    const int x0 = (int)x, y0 = (int)y, src = y0 * width + x0;
    const float after_x = x - (float)x0, after_y = y - (float)y0, after = fmax(after_x, after_y);
    const int next = after_x > 0.0f ? 1 : after_y > 0.0f ? width : 0;
    return (1.0f - after) * stored_code(codes, src) + after * stored_code(codes, src + next);
}

/* Whether a place lies outside of the rendered image. */
INLINE bool is_out_of_screen(const float3 px_source, __constant Frame *frame) {
    return !lands(px_source, frame->source_width, frame->source_height);
}

/* Whether the border of the rendered frame shows a mover where a place out of screen is closest to it, such as the
   pillar of a cab: it hides what goes on beyond the image. */
INLINE bool border_shows_mover(const float2 px_source, __constant Frame *frame, const Images f) {
    const int x = (int)clamp(px_source.x, 0.0f, (float)(frame->source_width - 1)),
              y = (int)clamp(px_source.y, 0.0f, (float)(frame->source_height - 1));
    return f.source_is_dynamic[y * frame->source_width + x];
}

/* Whether a surface can be at a place of the rendered frame: not in front of that which the frame shows there. */
INLINE bool can_be_at(const float3 px_source, __constant Frame *frame, __global const float *source_depth) {
    const float shown = source_depth[(int)px_source.y * frame->source_width + (int)px_source.x];
    return !INVALID_DEPTH(shown) && !(px_source.z < IN_FRONT * shown);
}

/* The sum of inverse distances of the surface that direction j meets, if that can be there. */
INLINE float support_of(const int j, __local const Side *sides) {
    float sum = 0.0f;
    for (int k = 0; sides[j].can_be_there && k < DIRECTIONS; ++k)
        if (sides[k].can_be_there && is_as_far(sides[j].inverse, sides[k].inverse)) sum += sides[k].closeness;
    return sum;
}

/* The directions that meet the surface behind a disocclusion. Candidates are static surfaces that, continued into the
   disocclusion, can be there in the rendered frame. Of these, the one with the most support counts; without candidates
   the far side. */
INLINE int surface_behind(__local const Side *sides) {
    float most = 0.0f, inverse = 0.0f;
    for (int j = 0; j < DIRECTIONS; ++j) {
        if (!(sides[j].support > most)) continue;
        most = sides[j].support;
        inverse = sides[j].inverse;
    }
    if (!(most > 0.0f)) return far_side(sides);
    int behind = 0;
    for (int k = 0; k < DIRECTIONS; ++k) behind |= (sides[k].can_be_there && is_as_far(sides[k].inverse, inverse)) << k;
    return behind;
}

INLINE bool meets_any(__local const Side *sides) {
    bool any = false;
    for (int k = 0; k < DIRECTIONS; ++k) any |= sides[k].meets;
    return any;
}

/* The directions whose surfaces fill a hole: those that lie outside of the rendered image, then *is_out; else those
   behind the disocclusion. */
INLINE int continued_directions(__local const Side *sides, bool *is_out) {
    int out_of_screen = 0;
    for (int k = 0; k < DIRECTIONS; ++k) out_of_screen |= sides[k].is_outside << k;
    *is_out = out_of_screen != 0;
    return out_of_screen ? out_of_screen : surface_behind(sides);
}

/* Continues the surfaces of the first valid pixels in eight directions: a surface that, continued into the hole, lies
   outside of the rendered image was hidden by nothing. If there are such, the hole is theirs: its depth is the mean of
   theirs, in which those close by count most, its color that of the border. Else it is a disocclusion, and
   shows the surface behind it. In an image without any valid pixel that is what the rendered frame shows in this place,
   at infinity. Gives (color, inverse depth). */
INLINE float4 continued_surface(const int dst_x, const int dst_y, __local const Side *sides, __constant Frame *frame,
                                const Images f) {
    const float offset = frame->code_offset;
    if (!meets_any(sides))
        return (float4)(decode_color(border_code(pixel_center(dst_x, dst_y), frame, f.codes), offset), 0.0f);
    bool out_of_screen;
    const int directions = continued_directions(sides, &out_of_screen);
    float4 mean = weighted_mean(sides, directions, out_of_screen, offset);
    const float3 px_source = static_source(dst_x, dst_y, mean.w, frame->to_source);
    if (out_of_screen && px_source.z > 0.0f && !border_shows_mover(px_source.xy, frame, f))
        mean.xyz = decode_color(border_code(px_source.xy, frame, f.codes), offset);
    return mean;
}

/* ---- fill ------------------------------------------------------------------------------------------------------ */

/* Fills a pixel with a mean (color, inverse depth), and with the motion of a static point. */
INLINE void fill_pixel(const int dst_x, const int dst_y, const float4 mean, __constant Frame *frame, const Images f) {
    const int dst = dst_y * frame->target_width + dst_x;
    const float3 px_source = static_source(dst_x, dst_y, mean.w, frame->to_source);
    f.depth[dst] = mean.w > 0.0f ? divide(1.0f, mean.w) : INFINITY;
    f.motion[dst] = px_source.z > 0.0f ? px_source.xy - pixel_center(dst_x, dst_y) : (float2)(0.0f);
    store_color(mean.xyz, f.color, dst);
}

INLINE bool is_unfilled(const uint entry, __global const uchar *filled_by) {
    return entry != NO_ENTRY && filled_by[entry] == BY_HOLE_FILLING;
}

/* Whether a pixel of the new frame shows a mover, or what was made up for one. */
INLINE bool is_of_mover(const int dst, const Images f) { return f.is_dynamic[dst] || IS_OF_MOVER(f.filled_by[dst]); }

/* Whether something beside a hole is static, and nothing out of screen: then it is neither inside a mover nor beyond
   the image. */
INLINE bool may_look_past(__local const Side *sides) {
    bool any_is_static = false, any_is_outside = false;
    for (int k = 0; k < DIRECTIONS; ++k) {
        any_is_static |= sides[k].meets && !sides[k].is_of_mover;
        any_is_outside |= sides[k].is_outside;
    }
    return any_is_static && !any_is_outside;
}

/* The pixel of the rendered frame that shows what is behind the surface that direction k meets, PAST_EDGE steps towards
   the hole; -1 unless that surface ends there, before something static that is farther. */
INLINE int behind_edge(const Side side, const int k, __constant Frame *frame, const Images f) {
    const int width = frame->source_width;
    const int2 d = direction(k);
    const float2 place = pixel_center(side.px % frame->target_width, side.px / frame->target_width) + f.motion[side.px]
                         - PAST_EDGE * (float2)((float)d.x, (float)d.y);
    if (!holds(width, frame->source_height, place)) return -1;
    const int src = (int)place.y * width + (int)place.x;
    const float z = f.source_depth[src];
    if (INVALID_DEPTH(z) || f.source_is_dynamic[src]) return -1;
    return side.inverse > inverse_of(z) * FAR_SIDE ? src : -1;
}

/* Code and depth of a pixel of the new frame. */
INLINE float4 code_at(const int dst, __constant Frame *frame, const Images f) {
    return (float4)(load_code(f.color, dst, frame->code_offset), f.depth[dst]);
}

/* Lets a direction from a hole meet what is behind the surface that it has met, in the rendered frame's pixel `src`. */
INLINE void meet_behind(Side *side, const int dst_x, const int dst_y, const int src, __constant Frame *frame,
                        const Images f) {
    show(side, (float4)(stored_code(f.codes, src), f.source_depth[src]));
    side->closeness *= BEHIND_EDGE;
    const float3 px_source = static_source(dst_x, dst_y, side->inverse, frame->to_source);
    const bool is_outside = is_out_of_screen(px_source, frame);
    side->is_outside = is_outside && !side->is_of_mover;
    side->can_be_there = is_outside ? side->is_of_mover : can_be_at(px_source, frame, f.source_depth);
}

/* Looks on in direction k, past the mover or the surface before the hole (a bar, say) that it has met, for a static
   surface that can be there. Without any it meets what the rendered frame shows behind that. */
INLINE void look_past(const int dst_x, const int dst_y, const int k, const int reach, __constant Frame *frame,
                      const Images f, __local Side *side) {
    const int width = frame->target_width, dst = dst_y * width + dst_x;
    const int2 d = direction(k);
    const int offset = d.y * width + d.x, steps = steps_within(reach, d, dst_x, dst_y, width, frame->target_height);
    float before = side->is_of_mover ? 0.0f : f.depth[side->px]; /* depth of the last surface that cannot be there */
    const int met = (side->px - dst) / offset, last = min(steps, met + reach / PAST_SHARE);
    for (int t = met + 1; t <= last; ++t) {
        const int px = dst + t * offset;
        if (f.filled_by[px] == BY_HOLE_FILLING) continue; /* others write depth there */
        const float z = f.depth[px];
        if (!(z > before) || is_of_mover(px, f)) continue;
        const float3 px_source = static_source(dst_x, dst_y, inverse_of(z), frame->to_source);
        if (!is_out_of_screen(px_source, frame) && can_be_at(px_source, frame, f.source_depth)) {
            Side found = {.meets = true, .can_be_there = true};
            meet(&found, dst, t, d, frame);
            show(&found, code_at(px, frame, f));
            TELL(f, TOLD_OF_SIDE * k + PAST, side->px + 1);
            *side = found;
            return;
        }
        before = z;
    }
    const int behind = behind_edge(*side, k, frame, f);
    if (behind < 0) return;
    TELL(f, TOLD_OF_SIDE * k + ENDS, 1);
    Side found = *side;
    meet_behind(&found, dst_x, dst_y, behind, frame, f);
    *side = found;
}

/* What a hole meets in direction k, up to `reach` px away. */
INLINE Side look_beside(const int dst_x, const int dst_y, const int k, const int reach, __constant Frame *frame,
                        const Images f) {
    Side s = look(dst_x, dst_y, k, reach, frame, f.filled_by, BY_HOLE_FILLING);
    if (!s.meets) return s;
    show(&s, code_at(s.px, frame, f));
    const float3 px_source = static_source(dst_x, dst_y, s.inverse, frame->to_source);
    s.is_of_mover = is_of_mover(s.px, f);
    const bool ends = behind_edge(s, k, frame, f) >= 0, is_outside = is_out_of_screen(px_source, frame);
    s.is_outside = is_outside && !ends;
    s.can_be_there = !is_outside && !ends && !s.is_of_mover && can_be_at(px_source, frame, f.source_depth);
    return s;
}

/* What a team's hole meets. Where that is nothing within reach, directions go on to the image's border. All work-items
   of a group must come here. */
INLINE void look_around(const uint hole, __constant Frame *frame, const Images f, __local Side *sides) {
    const int width = frame->target_width, item = get_local_id(0);
    const int reach = max(LEAST_REACH, width / REACH_SHARE), whole = reach + width + frame->target_height;
    const bool is_open = is_unfilled(hole, f.filled_by);
    const int hole_x = (int)hole % width, hole_y = (int)hole / width;
    bool looks = is_open, looks_past = false;
#pragma unroll 1
    for (int to = reach; to <= whole; to += whole - reach) {
        for (int k = item % TEAM; looks && k < DIRECTIONS; k += TEAM)
            sides[k] = look_beside(hole_x, hole_y, k, to, frame, f);
        WAIT_FOR_TEAM();
        looks_past |= is_open && to == reach && may_look_past(sides);
        looks &= !meets_any(sides);
        WAIT_FOR_TEAM();
    }
    for (int k = item % TEAM; looks_past && k < DIRECTIONS; k += TEAM)
        if (sides[k].meets && !sides[k].can_be_there) look_past(hole_x, hole_y, k, reach, frame, f, &sides[k]);
    WAIT_FOR_TEAM();
    for (int k = item % TEAM; is_open && k < DIRECTIONS; k += TEAM) sides[k].support = support_of(k, sides);
    WAIT_FOR_TEAM();
}

/* Fills pixels that are still invalid from the far side, a team of work-items for each. */
WALK __kernel void fill_far_side(__constant Frame *restrict frame, __global const uint *open,
                                 __global const uchar *filled_by, __global const half *codes,
                                 __global const float *source_depth, __global const uchar *source_is_dynamic,
                                 __global const uchar *is_dynamic, __global half *color, __global float *depth,
                                 __global float2 *motion) {
    __local Side sides[TEAMS][DIRECTIONS];
    const Images images = {.filled_by = filled_by,
                           .codes = codes,
                           .source_depth = source_depth,
                           .source_is_dynamic = source_is_dynamic,
                           .is_dynamic = is_dynamic,
                           .color = color,
                           .depth = depth,
                           .motion = motion};
    const int width = frame->target_width, item = get_local_id(0), team = item / TEAM;
    for (uint first = get_group_id(0) * TEAMS; first < open[0]; first += get_num_groups(0) * TEAMS) {
        look_around(entry_of(open, first + team), frame, images, sides[team]);
        const uint own = item < TEAMS ? entry_of(open, first + item) : NO_ENTRY;
        if (is_unfilled(own, filled_by)) {
            const int dst_x = (int)own % width, dst_y = (int)own / width;
            fill_pixel(dst_x, dst_y, continued_surface(dst_x, dst_y, sides[item], frame, images), frame, images);
        }
        WAIT_FOR_TEAM();
    }
}

/* ---- downsampled, as in the paper ------------------------------------------------------------------------------ */

/* Weighted sums, (color, 1) and inverse depth, over the pixels of each texel of the image downsampled 32x: of valid
   pixels, and a little of the rendered frame. A column of them per work-item, a texel per work-group. */
__kernel __attribute__((reqd_work_group_size(DOWNSAMPLING, 1, 1))) void
downsample(__constant Frame *restrict frame, __global const uchar *filled_by, __global const half *source_color,
           __global const float *source_depth, __global const half *color, __global const float *depth,
           __global float4 *downsampled_color, __global float *downsampled_inverse_depth) {
    __local float4 sums[DOWNSAMPLING];
    __local float inverse_sums[DOWNSAMPLING];
    const int width = frame->target_width, height = frame->target_height;
    const int column = get_local_id(0), dst_x = get_global_id(0), first_y = get_global_id(1) * DOWNSAMPLING;
    const int end_y = dst_x < width ? min(first_y + DOWNSAMPLING, height) : first_y;
    float4 sum = (float4)(0.0f);
    float inverse_sum = 0.0f;
    for (int dst_y = first_y; dst_y < end_y; ++dst_y) {
        const int dst = dst_y * width + dst_x;
        if (filled_by[dst] != BY_HOLE_FILLING)
            add(&sum, &inverse_sum, 1.0f, frame->exposure, load_color(color, dst), depth[dst]);
        const int src =
            (dst_y * frame->source_height / height) * frame->source_width + dst_x * frame->source_width / width;
        const float z = source_depth[src];
        if (!INVALID_DEPTH(z))
            add(&sum, &inverse_sum, RENDERED_WEIGHT, frame->exposure, load_color(source_color, src), z);
    }
    sums[column] = sum;
    inverse_sums[column] = inverse_sum;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (column) return;
    for (int k = 1; k < DOWNSAMPLING; ++k) {
        sum += sums[k];
        inverse_sum += inverse_sums[k];
    }
    const int texel = get_global_id(1) * ((width + DOWNSAMPLING - 1) / DOWNSAMPLING) + dst_x / DOWNSAMPLING;
    downsampled_color[texel] = sum;
    downsampled_inverse_depth[texel] = inverse_sum;
}

/* Fills holes from the four texels around each. */
WALK __kernel void fill_from_downsampled(__constant Frame *restrict frame, __global const uint *open,
                                         __global const uchar *filled_by, __global const float4 *downsampled_color,
                                         __global const float *downsampled_inverse_depth, __global half *color,
                                         __global float *depth, __global float2 *motion) {
    const Images images = {.color = color, .depth = depth, .motion = motion};
    const int width = (frame->target_width + DOWNSAMPLING - 1) / DOWNSAMPLING,
              height = (frame->target_height + DOWNSAMPLING - 1) / DOWNSAMPLING;
    for (uint i = get_global_id(0); i < open[0]; i += get_global_size(0)) {
        if (!is_unfilled(LISTED(open, i), filled_by)) continue;
        const int dst = (int)LISTED(open, i), dst_x = dst % frame->target_width, dst_y = dst / frame->target_width;
        const float2 place = pixel_center(dst_x, dst_y) * (1.0f / DOWNSAMPLING) - 0.5f, first = floor(place);
        float4 sum = (float4)(0.0f);
        float inverse_sum = 0.0f;
        for (int tap = 0; tap < 4; ++tap) {
            const int x = clamp((int)first.x + (tap & 1), 0, width - 1),
                      y = clamp((int)first.y + (tap >> 1), 0, height - 1);
            const float weight = bilinear_weight(tap, place.x - first.x, place.y - first.y);
            sum += weight * downsampled_color[y * width + x];
            inverse_sum += weight * downsampled_inverse_depth[y * width + x];
        }
        const float4 mean =
            sum.w > 0.0f ? (float4)(mean_of(sum.xyz, sum.w), divide(inverse_sum, sum.w)) : (float4)(0.0f);
        fill_pixel(dst_x, dst_y, mean, frame, images);
    }
}
