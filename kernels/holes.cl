/* Hole filling: pixels that are still invalid continue the surface behind the disocclusion or, out of screen, the lines
   at the image's border, or come from the image downsampled 32 times (paper: 'Shading correction network'). Only pixels
   labeled for filling change, and keep their label. The downsampled image is only computed for pixels that need it. */

#include "frame.h"
#include "color_code.h"
#include "directional_search.h"
#include "lists.h"
#include "shown_before.h"

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
    __global const half *source_color;
    __global const half *codes; /* of it */
    __global const float *source_depth;
    __global const uchar *source_is_dynamic, *is_dynamic;
    __global const float *border_lines;
    __global half *color;
    __global float *depth;
    __global float2 *motion;
} Images;

/* Adds a pixel to the sums; those that are displayed bright weigh less, or one lamp would fill its whole texel. */
INLINE void add(float4 *sum, float *inverse_sum, const float pixel_weight, const float exposure, const float3 c,
                const float z) {
    const float weight = divide(pixel_weight, 1.0f + exposure * fmax(fmax(c.x, fmax(c.y, c.z)), 0.0f));
    *sum += weight * (float4)(c, 1.0f);
    *inverse_sum += weight * (isinf(z) ? 0.0f : divide(1.0f, z));
}

/* ---- far side ------------------------------------------------------------------------------------------------ */

#define FAR_SIDE 1.3f /* inverse depths up to this times another are of the same surface, or of a farther one */
#define PAST_SHARE 4 /* part of the reach within which directions look past what they have met */
#define IN_FRONT 0.98f /* times the depth that is shown: nearer surfaces lie in front of it */
#define PAST_EDGE 2.0f /* steps in the rendered frame from the edge of a surface to what is behind it ... */
#define BEHIND_EDGE 0.25f /* which counts this much of what is beside the hole */

INLINE float inverse_of(const float z) { return isinf(z) ? 0.0f : divide(1.0f, z); }

/* What a direction from a hole meets: whether it `meets` a pixel beside the hole, the pixel, its code, inverse depth
   and 1 / distance (1/px); whether it is a mover's; continued to the hole, whether it lies outside of the rendered
   image, and whether it can be there as a static surface. */
typedef struct {
    bool meets, is_of_mover, is_outside, can_be_there;
    int px;
    float closeness, inverse, code_x, code_y, code_z;
} Side;

/* Lets a direction from the hole `dst` meet a pixel, t steps of d away. */
INLINE void meet(Side *side, const int dst, const int t, const int2 d, __constant Frame *frame,
                 __global const float *depth, __global const half *color) {
    const int px = dst + t * (d.y * frame->target_width + d.x);
    const float z = depth[px];
    const float3 code = load_code(color, px, frame->code_offset);
    side->px = px;
    side->closeness = divide(1.0f, (float)t * step_length(d));
    side->inverse = inverse_of(z);
    side->code_x = code.x;
    side->code_y = code.y;
    side->code_z = code.z;
}

/* Looks in direction k from a hole, up to `reach` px away, for a pixel that `mask` does not call a `hole`. */
INLINE Side look(const int dst_x, const int dst_y, const int k, const int reach, __constant Frame *frame,
                 __global const uchar *mask, const uchar hole, __global const float *depth,
                 __global const half *color) {
    const int width = frame->target_width, dst = dst_y * width + dst_x;
    const int2 d = direction(k);
    const int offset = d.y * width + d.x;
    const int t =
        first_other(dst, offset, steps_within(reach, d, dst_x, dst_y, width, frame->target_height), mask, hole);
    Side side = {t != 0, false, false, false, dst, 0.0f, INFINITY, 0.0f, 0.0f, 0.0f};
    if (t != 0) meet(&side, dst, t, d, frame, depth, color);
    return side;
}

INLINE bool is_as_far(const float inverse, const float other) {
    return !(inverse > other * FAR_SIDE) && !(other > inverse * FAR_SIDE);
}

/* The directions that meet the far side, in bits. */
INLINE int far_side(__local const Side *sides) {
    float least = INFINITY;
    int far = 0;
    for (int k = 0; k < DIRECTIONS; ++k) least = fmin(least, sides[k].inverse);
    for (int k = 0; k < DIRECTIONS; ++k) far |= (sides[k].meets && !(sides[k].inverse > least * FAR_SIDE)) << k;
    return far;
}

/* Mean (color, inverse depth) of the pixels in some directions, weighted by their closeness, or by its `square`. */
INLINE float4 weighted_mean(__local const Side *sides, const int directions, const bool square,
                            const float code_offset) {
    float4 sum = (float4)(0.0f);
    float weight_sum = 0.0f;
    for (int k = 0; k < DIRECTIONS; ++k) {
        if (!has(directions, k)) continue;
        const Side s = sides[k];
        const float weight = square ? s.closeness * s.closeness : s.closeness;
        sum += weight * (float4)(s.code_x, s.code_y, s.code_z, s.inverse);
        weight_sum += weight;
    }
    return (float4)(decode_color(mean_of(sum.xyz, weight_sum), code_offset), divide(sum.w, weight_sum));
}

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
    return !(px_source.z > 0.0f && holds(frame->source_width, frame->source_height, px_source.xy));
}

/* Color of pixels out of screen beyond the reach of the far side: the mean of the color around and of the image's
   border. */
INLINE float3 continued(const float3 beside, const float3 px_source, __constant Frame *frame,
                        __global const half *codes) {
    if (!(px_source.z > 0.0f)) return beside;
    const float3 border = border_code(px_source.xy, frame, codes);
    return decode_color(0.5f * (encode_color(beside, frame->code_offset) + border), frame->code_offset);
}

/* ---- lines at the image's border --------------------------------------------------------------------------------- */

#define CELL 8 /* px each way, of the grid "cells" */
#define LINE_STRIDE 2 /* px between its samples */
#define CELLS_AROUND 4 /* along the border, on either side, over which lines have one direction ... */
#define CLOSE_COUNTS 4.0f /* ... close by most: one a cell away counts 1 / (1 + CLOSE_COUNTS), and more farther out */
#define STEEPEST 2.0f /* px along the border, by which lines run on per px out of the image */
#define CELL_NOISE 0.0001f /* of the sum of squared changes in a cell, colors displayed as white being 1 */
#define APPROACHES 2 /* of the place where a line leaves the image */
#define BLUR_TAPS 4 /* on either side along the border */
#define FADE 0.16f /* px between them per px out of the image, in units of what the lines' direction leaves open */

/* Sums over samples of a cell: products of the changes of color codes in x and y (the structure tensor). */
INLINE void find_lines(const int cell_x, const int cell_y, __constant Frame *frame, __global const half *codes,
                       __global float *border_lines) {
    const int width = frame->source_width, height = frame->source_height;
    const int first_x = max(min(cell_x * CELL, width - CELL), 0) + 1,
              first_y = max(min(cell_y * CELL, height - CELL), 0) + 1;
    float xx = 0.0f, xy = 0.0f, yy = 0.0f;
    for (int y = first_y; y < min(first_y + CELL - 1, height - 1); y += LINE_STRIDE)
        for (int x = first_x; x < min(first_x + CELL - 1, width - 1); x += LINE_STRIDE) {
            const int src = y * width + x;
            const float3 dx = 0.5f * (stored_code(codes, src + 1) - stored_code(codes, src - 1));
            const float3 dy = 0.5f * (stored_code(codes, src + width) - stored_code(codes, src - width));
            xx += dx.x * dx.x + dx.y * dx.y + dx.z * dx.z;
            xy += dx.x * dy.x + dx.y * dy.y + dx.z * dy.z;
            yy += dy.x * dy.x + dy.y * dy.y + dy.z * dy.z;
        }
    const int cell = cell_y * frame->cells_width + cell_x, plane = frame->cells_width * frame->cells_height;
    border_lines[cell] = xx;
    border_lines[plane + cell] = xy;
    border_lines[2 * plane + cell] = yy;
}

/* The cells at the image's border that are those of work-item `item` of `items`: of the first and last row, then of the
   first and last column. */
INLINE void find_border_lines(const int item, const int items, __constant Frame *frame, __global const half *codes,
                              __global float *border_lines) {
    const int width = frame->cells_width, height = frame->cells_height;
    for (int k = item; k < 2 * (width + max(height - 2, 0)); k += items) {
        const int along = k >> 1, is_last = k & 1;
        const bool in_row = along < width;
        const int cell_x = in_row ? along : is_last * (width - 1);
        const int cell_y = in_row ? is_last * (height - 1) : along - width + 1;
        find_lines(cell_x, cell_y, frame, codes, border_lines);
    }
}

DEFINE_ROOT(float, root)

/* The lines that cross the border around a place on it. */
typedef struct {
    float slope; /* px along the border, per px along the other axis */
    float spread; /* by how much that is uncertain: the root of the change that it leaves unexplained */
} Lines;

/* Lines at the border's pixel `along` (px in x if the border is `horizontal`, else in y), in the border's row or
   column of cells that begins at cell `first`, for a place `out` px out of the image. */
INLINE Lines lines_at(const float along, const float out, const bool horizontal, const int first,
                      __constant Frame *frame, __global const float *border_lines) {
    const int plane = frame->cells_width * frame->cells_height;
    const int count = horizontal ? frame->cells_width : frame->cells_height, step = horizontal ? 1 : frame->cells_width;
    const float side = (float)(horizontal ? frame->source_width : frame->source_height);
    const float at = clamp(along, 0.0f, side) * (1.0f / CELL) - 0.5f;
    const int low = (int)floor(at);
    const float cells_out = out * (1.0f / CELL), close_counts = divide(CLOSE_COUNTS, 1.0f + cells_out * cells_out);
    float across = 0.0f, both = 0.0f, inward = 0.0f;
    for (int k = max(low - CELLS_AROUND + 1, 0); k <= min(low + CELLS_AROUND, count - 1); ++k) {
        const float off = at - (float)k, part = off * (1.0f / CELLS_AROUND);
        const float window = fmax(1.0f - part * part, 0.0f),
                    weight = divide(window * window, 1.0f + close_counts * off * off);
        const int cell = first + k * step;
        across += weight * border_lines[(horizontal ? 0 : 2 * plane) + cell];
        both += weight * border_lines[plane + cell];
        inward += weight * border_lines[(horizontal ? 2 * plane : 0) + cell];
    }
    const float white = frame->code_offset > 0.0f ? 4.0f * frame->code_offset * frame->code_offset : 1.0f;
    const float sure = across + CELL_NOISE * white * white;
    Lines lines;
    lines.slope = clamp(-divide(both, sure), -STEEPEST, STEEPEST);
    const float unexplained = inward + lines.slope * (2.0f * both + lines.slope * across);
    lines.spread = root(divide(fmax(unexplained, 0.0f), sure));
    return lines;
}

/* Whether the border of the rendered frame shows a mover where a place out of screen is closest to it, such as the
   pillar of a cab: it hides what goes on beyond the image. */
INLINE bool border_shows_mover(const float2 px_source, __constant Frame *frame, const Images f) {
    const int x = (int)clamp(px_source.x, 0.0f, (float)(frame->source_width - 1)),
              y = (int)clamp(px_source.y, 0.0f, (float)(frame->source_height - 1));
    return f.source_is_dynamic[y * frame->source_width + x];
}

/* Color of a place out of screen: lines at the border of the rendered image go on, and fade where they have no common
   direction. */
INLINE float3 color_beyond(const float2 px_source, __constant Frame *frame, const Images f) {
    const int width = frame->source_width, height = frame->source_height;
    const float out_x = clamp(px_source.x, 0.5f, (float)width - 0.5f) - px_source.x;
    const float out_y = clamp(px_source.y, 0.5f, (float)height - 0.5f) - px_source.y;
    const bool horizontal = fabs(out_y) > fabs(out_x);
    const float out = clamp(horizontal ? out_y : out_x, -(float)width, (float)width); /* finite */
    const int first = !(out < 0.0f) ? 0
                      : horizontal  ? (frame->cells_height - 1) * frame->cells_width
                                    : frame->cells_width - 1;
    float along = horizontal ? px_source.x : px_source.y;
    const float start = along;
    Lines lines;
    for (int k = 0; k < APPROACHES; ++k) {
        lines = lines_at(along, out, horizontal, first, frame, f.border_lines);
        along = start + out * lines.slope;
    }
    const float apart = FADE * lines.spread * fabs(out);
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int k = -BLUR_TAPS; k <= BLUR_TAPS; ++k) {
        const float at = along + apart * (float)k, part = (float)k * (1.0f / (BLUR_TAPS + 1)),
                    weight = 1.0f - part * part;
        const float2 place = horizontal ? (float2)(at, px_source.y) : (float2)(px_source.x, at);
        sum += weight * border_code(place, frame, f.codes);
        weight_sum += weight;
    }
    return decode_color(mean_of(sum, weight_sum), frame->code_offset);
}

/* Whether a surface can be at a place of the rendered frame: not in front of that which the frame shows there. */
INLINE bool can_be_at(const float3 px_source, __constant Frame *frame, __global const float *source_depth) {
    const float shown = source_depth[(int)px_source.y * frame->source_width + (int)px_source.x];
    return !INVALID_DEPTH(shown) && !(px_source.z < IN_FRONT * shown);
}

/* The directions that meet the surface behind a disocclusion. Candidates are static surfaces that, continued into the
   disocclusion, can be there in the rendered frame. Of these, the surface with the largest sum of inverse distances
   counts; without candidates the far side. */
INLINE int surface_behind(__local const Side *sides) {
    float most = 0.0f, inverse = 0.0f;
    for (int j = 0; j < DIRECTIONS; ++j) {
        float sum = 0.0f;
        for (int k = 0; sides[j].can_be_there && k < DIRECTIONS; ++k)
            if (sides[k].can_be_there && is_as_far(sides[j].inverse, sides[k].inverse)) sum += sides[k].closeness;
        if (!(sum > most)) continue;
        most = sum;
        inverse = sides[j].inverse;
    }
    if (!(most > 0.0f)) return far_side(sides);
    int behind = 0;
    for (int k = 0; k < DIRECTIONS; ++k) behind |= (sides[k].can_be_there && is_as_far(sides[k].inverse, inverse)) << k;
    return behind;
}

/* Continues the surfaces of the first valid pixels in eight directions: a surface that, continued into the hole, lies
   outside of the rendered image was hidden by nothing. If there are such, the hole is theirs: its depth is the mean of
   theirs, in which those close by count most, its color that of lines at the border. Else it is a disocclusion, and
   shows the surface behind it. Gives (color, inverse depth); false where no direction meets a valid pixel. */
INLINE bool continue_surface(const int dst_x, const int dst_y, __local const Side *sides, __constant Frame *frame,
                             const Images f, float4 *mean) {
    int met = 0, out_of_screen = 0;
    for (int k = 0; k < DIRECTIONS; ++k) {
        met |= sides[k].meets << k;
        out_of_screen |= sides[k].is_outside << k;
    }
    if (!met) return false;
    *mean = weighted_mean(sides, out_of_screen ? out_of_screen : surface_behind(sides), out_of_screen != 0,
                          frame->code_offset);
    if (!out_of_screen) return true;
    const float3 px_source = static_source(dst_x, dst_y, mean->w, frame->to_source);
    if (px_source.z > 0.0f && !border_shows_mover(px_source.xy, frame, f))
        mean->xyz = color_beyond(px_source.xy, frame, f);
    return true;
}

#define MIXED_REACH 16 /* px beyond which the far side does not represent the remembered surface */
#define CONTRAST 0.4f /* of the far side, relative to its mean, with which it counts half */

INLINE float squared(const float3 c) { return c.x * c.x + c.y * c.y + c.z * c.z; }

INLINE float brightness(const float3 c) { return (c.x + c.y + c.z) * (1.0f / 3.0f); }

/* Weight of the far side's `mean` relative to a remembered color. It grows if the far side is near and uniform. */
INLINE float weight_of_far_side(__local const Side *sides, const int far, const float3 mean,
                                __global const half *color) {
    float closest = 0.0f, sum = 0.0f, weight_sum = 0.0f;
    for (int k = 0; k < DIRECTIONS; ++k) {
        if (!has(far, k)) continue;
        const float off = brightness(load_color(color, sides[k].px) - mean), closeness = sides[k].closeness;
        closest = fmax(closest, closeness);
        sum += closeness * off * off;
        weight_sum += closeness;
    }
    const float typical = CONTRAST * brightness(mean), uniform = typical * typical, spread = divide(sum, weight_sum);
    return spread > 0.0f ? closest * divide(uniform, uniform + spread) : closest;
}

#define BEYOND_EDGE 4 /* px beyond the edge of a hole, where colors do not change with the mover's outline */
#define LEAST_CHANGE 0.001f /* squared change around, by which remembered colors count half; white is 1 */
#define CONTRAST_COUNTS 4.0f /* of the squared difference from colors around, times that by which it counts half */

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
    return (float4)(code, squared(change));
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
    const float contrast = squared(remembered - mean_of(sum.xyz, known));
    return divide(change, change + CONTRAST_COUNTS * contrast + 3.0f * LEAST_CHANGE * white * white);
}

/* Mixes a fill of the background with the far side. A surface's remembered color may be out of date, so the weighted
   mean with the present color beside it is shown. */
INLINE void mix_far_side(const int dst, __local const Side *sides, __local const float4 *changes,
                         __constant Frame *frame, __global half *color) {
    const int far = far_side(sides);
    if (!far) return;
    const float3 mean = weighted_mean(sides, far, false, frame->code_offset).xyz;
    const float counts = weight_of_far_side(sides, far, mean, color);
    const float3 remembered = load_code(color, dst, frame->code_offset);
    const float stale = staleness(remembered, changes, far, frame->code_offset);
    const float3 sum = (1.0f - stale) * remembered + (stale + counts) * encode_color(mean, frame->code_offset);
    store_code(mean_of(sum, 1.0f + counts), color, dst, frame->code_offset);
}

/* Whether an open pixel is a hole that the background has filled. */
INLINE bool is_of_background(const uint entry, __global const uchar *filled_by) {
    return entry < MIXED_FLAG && filled_by[entry] != BY_HOLE_FILLING && !IS_OF_MOVER(filled_by[entry]);
}

/* Two preparations for fill_far_side, which do not touch each other's buffers. Lines at the image's border, but not
   under a camera that stays, which has nothing out of screen. And the background's fills are mixed with the far side, a
   team of work-items for each. */
WALK __kernel void prepare_far_side(__constant Frame *restrict frame, __global const half *codes,
                                    __global const uint *open, __global const uchar *disoccluded,
                                    __global const uchar *filled_by, __global const half *color_prev,
                                    __global const float *depth_prev, __global const float *depth, __global half *color,
                                    __global float *border_lines, __global uint *beyond) {
    __local Side sides[TEAMS][DIRECTIONS];
    __local float4 changes[TEAMS][DIRECTIONS];
    const Before before = {.color = color_prev, .depth = depth_prev, .state = 0};
    const int width = frame->target_width, item = get_local_id(0), team = item / TEAM;
    if (get_global_id(0) == 0) *beyond = 0;
    if (!frame->stays) find_border_lines(get_global_id(0), get_global_size(0), frame, codes, border_lines);
    if (!frame->collects) return;
    for (uint first = get_group_id(0) * TEAMS; first < open[0]; first += get_num_groups(0) * TEAMS) {
        const uint hole = entry_of(open, first + team);
        const bool is_filled = is_of_background(hole, filled_by);
        for (int k = item % TEAM; is_filled && k < DIRECTIONS; k += TEAM) {
            sides[team][k] =
                look((int)hole % width, (int)hole / width, k, MIXED_REACH, frame, disoccluded, 1, depth, color);
            changes[team][k] = change_around(k, &sides[team][k], frame, before, disoccluded, depth, color);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        const uint own = item < TEAMS ? entry_of(open, first + item) : MIXED_FLAG;
        if (is_of_background(own, filled_by)) mix_far_side((int)own, sides[item], changes[item], frame, color);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

/* ---- fill ------------------------------------------------------------------------------------------------------ */

/* Fills a pixel's depth, and the motion of a static point. Gives where that is in the rendered image
   (static_source). */
INLINE float3 fill_geometry(const int dst_x, const int dst_y, const float inverse_depth, __constant Frame *frame,
                            const Images f) {
    const int dst = dst_y * frame->target_width + dst_x;
    const float3 px_source = static_source(dst_x, dst_y, inverse_depth, frame->to_source);
    f.depth[dst] = inverse_depth > 0.0f ? divide(1.0f, inverse_depth) : INFINITY;
    f.motion[dst] = px_source.z > 0.0f ? px_source.xy - pixel_center(dst_x, dst_y) : (float2)(0.0f);
    return px_source;
}

/* Fills a pixel with a mean (color, inverse depth), and with the motion of a static point. */
INLINE void fill_pixel(const int dst_x, const int dst_y, const float4 mean, __constant Frame *frame, const Images f) {
    fill_geometry(dst_x, dst_y, mean.w, frame, f);
    store_color(mean.xyz, f.color, dst_y * frame->target_width + dst_x);
}

#define BEYOND_REACH -1.0f /* depth of pixels that have no far side within reach, until they are filled */

INLINE bool is_unfilled(const uint entry, __global const uchar *filled_by) {
    return entry < MIXED_FLAG && filled_by[entry] == BY_HOLE_FILLING;
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

/* Lets a direction from a hole meet what is behind the surface that it has met, in the rendered frame's pixel `src`. */
INLINE void meet_behind(Side *side, const int dst_x, const int dst_y, const int src, __constant Frame *frame,
                        const Images f) {
    const float3 code = stored_code(f.codes, src);
    side->inverse = inverse_of(f.source_depth[src]);
    side->closeness *= BEHIND_EDGE;
    side->code_x = code.x;
    side->code_y = code.y;
    side->code_z = code.z;
    const float3 px_source = static_source(dst_x, dst_y, side->inverse, frame->to_source);
    const bool is_outside = is_out_of_screen(px_source, frame);
    side->is_outside = is_outside && !side->is_of_mover;
    side->can_be_there = is_outside ? side->is_of_mover : can_be_at(px_source, frame, f.source_depth);
}

/* Looks on in direction k, past the mover or the surface before the hole (a bar, say) that it has met, for a static
   surface that can be there. Without any it meets what the rendered frame shows behind that, and what was made up for a
   mover does not count either. */
INLINE void look_past(const int dst_x, const int dst_y, const int k, const int reach, __constant Frame *frame,
                      const Images f, __local Side *side) {
    const int width = frame->target_width, dst = dst_y * width + dst_x;
    const int2 d = direction(k);
    const int offset = d.y * width + d.x, steps = steps_within(reach, d, dst_x, dst_y, width, frame->target_height);
    float before = side->is_of_mover ? 0.0f : f.depth[side->px]; /* depth of the last surface that cannot be there */
    const int met = (side->px - dst) / offset, last = min(steps, met + reach / PAST_SHARE);
    for (int t = met + 1; t <= last; ++t) {
        const int px = dst + t * offset;
        if (f.filled_by[px] == BY_HOLE_FILLING || is_of_mover(px, f)) continue; /* others write depth there */
        const float z = f.depth[px];
        if (!(z > before)) continue;
        const float3 px_source = static_source(dst_x, dst_y, inverse_of(z), frame->to_source);
        if (!is_out_of_screen(px_source, frame) && can_be_at(px_source, frame, f.source_depth)) {
            Side found = {.meets = true, .can_be_there = true};
            meet(&found, dst, t, d, frame, f.depth, f.color);
            *side = found;
            return;
        }
        before = z;
    }
    const int behind = behind_edge(*side, k, frame, f);
    if (behind >= 0) {
        Side found = *side;
        meet_behind(&found, dst_x, dst_y, behind, frame, f);
        *side = found;
        return;
    }
    if (!IS_OF_MOVER(f.filled_by[side->px])) return;
    side->meets = false;
    side->inverse = INFINITY;
}

/* Fills pixels that are still invalid from the far side, a team of work-items for each. */
WALK __kernel void fill_far_side(__constant Frame *restrict frame, __global const uint *open,
                                 __global const uchar *filled_by, __global const half *codes,
                                 __global const float *source_depth, __global const uchar *source_is_dynamic,
                                 __global const uchar *is_dynamic, __global const float *border_lines,
                                 __global half *color, __global float *depth, __global float2 *motion,
                                 __global uint *beyond) {
    __local Side sides[TEAMS][DIRECTIONS];
    const Images images = {.filled_by = filled_by,
                           .codes = codes,
                           .source_depth = source_depth,
                           .source_is_dynamic = source_is_dynamic,
                           .is_dynamic = is_dynamic,
                           .border_lines = border_lines,
                           .color = color,
                           .depth = depth,
                           .motion = motion};
    const int width = frame->target_width, item = get_local_id(0), team = item / TEAM;
    const int reach = max(LEAST_REACH, width / REACH_SHARE);
    for (uint first = get_group_id(0) * TEAMS; first < open[0]; first += get_num_groups(0) * TEAMS) {
        const uint hole = entry_of(open, first + team);
        const bool is_open = is_unfilled(hole, filled_by);
        const int hole_x = (int)hole % width, hole_y = (int)hole / width;
        for (int k = item % TEAM; is_open && k < DIRECTIONS; k += TEAM) {
            Side s = look(hole_x, hole_y, k, reach, frame, filled_by, BY_HOLE_FILLING, depth, color);
            if (s.meets) {
                const float3 px_source = static_source(hole_x, hole_y, s.inverse, frame->to_source);
                s.is_of_mover = is_of_mover(s.px, images);
                const bool ends = behind_edge(s, k, frame, images) >= 0,
                           is_outside = is_out_of_screen(px_source, frame);
                s.is_outside = is_outside && !ends;
                s.can_be_there = !is_outside && !ends && !s.is_of_mover && can_be_at(px_source, frame, source_depth);
            }
            sides[team][k] = s;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        const bool looks_past = is_open && may_look_past(sides[team]);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int k = item % TEAM; looks_past && k < DIRECTIONS; k += TEAM)
            if (sides[team][k].meets && !sides[team][k].can_be_there)
                look_past(hole_x, hole_y, k, reach, frame, images, &sides[team][k]);
        barrier(CLK_LOCAL_MEM_FENCE);
        const uint own = item < TEAMS ? entry_of(open, first + item) : MIXED_FLAG;
        if (is_unfilled(own, filled_by)) {
            const int dst_x = (int)own % width, dst_y = (int)own / width;
            float4 mean;
            if (continue_surface(dst_x, dst_y, sides[item], frame, images, &mean)) {
                fill_pixel(dst_x, dst_y, mean, frame, images);
            } else {
                depth[own] = BEYOND_REACH;
                atomic_or(beyond, 1u);
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

/* ---- downsampled, as in the paper ------------------------------------------------------------------------------ */

#define TILE 4 /* texels along the side of a work-group's area: it needs those around them, too */
#define RING (TILE + 2)
#define GROUP 128 /* work-items of it: one per row of pixels, or DOWNSAMPLING columns of strips */
#define SUMMED_ROWS 8 /* rows of a texel that one work-item sums up */

/* The TILE x TILE texels that a work-group fills from, and the ring around them, whose first texel is (ring_x,
   ring_y). */
typedef struct {
    int ring_x, ring_y;
    int width, height; /* of the downsampled image */
    int after_far_side; /* only pixels are filled that the far side has left */
    __local float4 *sums; /* of the ring's texels: (color, 1), weighted ... */
    __local float *inverse_sums; /* ... and inverse depth */
    __local uint *asked, *any_asks; /* whether a pixel needs them */
} Tile;

/* The place of a pixel between the centers of four texels of the downsampled image: the first one, and how far from
   it. */
INLINE int2 first_texel(const int dst_x, const int dst_y, float2 *between) {
    const float2 b = pixel_center(dst_x, dst_y) * (1.0f / DOWNSAMPLING) - 0.5f;
    const float2 first = floor(b);
    *between = b - first;
    return convert_int2(first);
}

/* Index in the ring of one of the four, clamped to the image. */
INLINE int tap_in_ring(const int2 first, const int tap, const Tile tile) {
    const int texel_x = clamp(first.x + (tap & 1), 0, tile.width - 1);
    const int texel_y = clamp(first.y + (tap >> 1), 0, tile.height - 1);
    return (texel_y - tile.ring_y) * RING + texel_x - tile.ring_x;
}

/* Weighted sums, (color, 1) and inverse depth, over SUMMED_ROWS rows of a column: of valid pixels, and a little of the
   rendered frame. */
INLINE float4 sum_strip(const int dst_x, const int first_y, __constant Frame *frame, const Images f,
                        float *inverse_sum) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int source_width = frame->source_width, source_height = frame->source_height;
    float4 sum = (float4)(0.0f);
    *inverse_sum = 0.0f;
    if (dst_x >= target_width) return sum;
    for (int dst_y = first_y; dst_y < min(first_y + SUMMED_ROWS, target_height); ++dst_y) {
        const int dst = dst_y * target_width + dst_x;
        if (f.filled_by[dst] != BY_HOLE_FILLING)
            add(&sum, inverse_sum, 1.0f, frame->exposure, load_color(f.color, dst), f.depth[dst]);
        const int src = (dst_y * source_height / target_height) * source_width + dst_x * source_width / target_width;
        const float z = f.source_depth[src];
        if (!INVALID_DEPTH(z))
            add(&sum, inverse_sum, RENDERED_WEIGHT, frame->exposure, load_color(f.source_color, src), z);
    }
    return sum;
}

/* Whether a pixel is to be filled from the downsampled image. */
INLINE bool asks(const int dst, const Tile tile, const Images f) {
    return f.filled_by[dst] == BY_HOLE_FILLING && (!tile.after_far_side || f.depth[dst] == BEYOND_REACH);
}

/* Fills a pixel from the four texels around it; out of screen, after the far side, with the image's border too. */
INLINE void fill_between_texels(const int dst_x, const int dst_y, const Tile tile, __constant Frame *frame,
                                const Images f) {
    float2 between;
    const int2 first = first_texel(dst_x, dst_y, &between);
    float4 sum = (float4)(0.0f);
    float inverse_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const float weight = bilinear_weight(tap, between.x, between.y);
        const int k = tap_in_ring(first, tap, tile);
        sum += weight * tile.sums[k];
        inverse_sum += weight * tile.inverse_sums[k];
    }
    float4 mean = sum.w > 0.0f ? (float4)(mean_of(sum.xyz, sum.w), divide(inverse_sum, sum.w)) : (float4)(0.0f);
    const float3 px_source = fill_geometry(dst_x, dst_y, mean.w, frame, f);
    if (tile.after_far_side && is_out_of_screen(px_source, frame))
        mean.xyz = continued(mean.xyz, px_source, frame, f.codes);
    store_color(mean.xyz, f.color, dst_y * frame->target_width + dst_x);
}

/* The pixels of a row from first_x to end_x that are to be filled: `fills` them, else marks the texels that they
   need as asked for. */
INLINE void fill_or_ask(const bool fills, const int first_x, const int end_x, const int dst_y, const Tile tile,
                        __constant Frame *frame, const Images f) {
    for (int run_x = first_x; run_x < end_x; run_x += RUN) {
        const int run = dst_y * frame->target_width + run_x;
        if (run_x + RUN <= end_x && !run_has(f.filled_by + run, BY_HOLE_FILLING)) continue;
        for (int dst_x = run_x; dst_x < min(run_x + RUN, end_x); ++dst_x) {
            if (!asks(run + dst_x - run_x, tile, f)) continue;
            if (fills) {
                fill_between_texels(dst_x, dst_y, tile, frame, f);
            } else {
                float2 between;
                const int2 first = first_texel(dst_x, dst_y, &between);
                atomic_or(tile.any_asks, 1u);
                for (int tap = 0; tap < 4; ++tap) atomic_or(tile.asked + tap_in_ring(first, tap, tile), 1u);
            }
        }
    }
}

/* Fills the rest from the image downsampled 32x, interpolated: after the far side pixels `beyond` its reach. Every
   work-group fills the pixels under TILE x TILE texels: it sums up those of them, and of the ring around them, that its
   pixels ask for. The sums are kept for who wants to look at them. */
SPARSE __kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
fill_from_downsampled(__constant Frame *restrict frame, const int after_far_side, __global const uchar *filled_by,
                      __global const half *codes, __global const half *source_color, __global const float *source_depth,
                      __global half *color, __global float *depth, __global float2 *motion,
                      __global float4 *downsampled_color, __global float *downsampled_inverse_depth,
                      __global const uint *beyond) {
    const Images images = {.filled_by = filled_by,
                           .source_color = source_color,
                           .codes = codes,
                           .source_depth = source_depth,
                           .color = color,
                           .depth = depth,
                           .motion = motion};
    __local float4 sums[RING * RING], strip_sums[GROUP];
    __local float inverse_sums[RING * RING], strip_inverse_sums[GROUP];
    __local uint asked[RING * RING], any_asks;
    const Tile tile = {get_group_id(0) * TILE - 1,
                       get_group_id(1) * TILE - 1,
                       (frame->target_width + DOWNSAMPLING - 1) / DOWNSAMPLING,
                       (frame->target_height + DOWNSAMPLING - 1) / DOWNSAMPLING,
                       after_far_side,
                       sums,
                       inverse_sums,
                       asked,
                       &any_asks};
    const int lane = get_local_id(0);
    const int first_x = get_group_id(0) * TILE * DOWNSAMPLING, dst_y = get_group_id(1) * TILE * DOWNSAMPLING + lane;
    const int end_x = dst_y < frame->target_height ? min(first_x + TILE * DOWNSAMPLING, frame->target_width) : first_x;
    const int own_x = tile.ring_x + 1 + lane % TILE, own_y = tile.ring_y + 1 + lane / TILE,
              own = own_y * tile.width + own_x;
    const bool has_own = lane < TILE * TILE && own_x < tile.width && own_y < tile.height;

    if (lane < RING * RING) asked[lane] = 0;
    if (lane == 0) any_asks = 0;
    if (has_own) {
        downsampled_color[own] = (float4)(0.0f);
        downsampled_inverse_depth[own] = 0.0f;
    }
    if (after_far_side && !*beyond) return;
    barrier(CLK_LOCAL_MEM_FENCE);
    fill_or_ask(false, first_x, end_x, dst_y, tile, frame, images);
    barrier(CLK_LOCAL_MEM_FENCE);

    if (!any_asks) return;

    for (int k = 0; k < RING * RING; ++k) {
        if (!asked[k]) continue;
        float inverse_sum;
        strip_sums[lane] = sum_strip((tile.ring_x + k % RING) * DOWNSAMPLING + lane % DOWNSAMPLING,
                                     (tile.ring_y + k / RING) * DOWNSAMPLING + lane / DOWNSAMPLING * SUMMED_ROWS, frame,
                                     images, &inverse_sum);
        strip_inverse_sums[lane] = inverse_sum;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lane == 0) {
            sums[k] = (float4)(0.0f);
            inverse_sums[k] = 0.0f;
            for (int j = 0; j < GROUP; ++j) {
                sums[k] += strip_sums[j];
                inverse_sums[k] += strip_inverse_sums[j];
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    const int own_in_ring = (lane / TILE + 1) * RING + lane % TILE + 1;
    if (has_own && asked[own_in_ring]) {
        downsampled_color[own] = sums[own_in_ring];
        downsampled_inverse_depth[own] = inverse_sums[own_in_ring];
    }
    fill_or_ask(true, first_x, end_x, dst_y, tile, frame, images);
}
