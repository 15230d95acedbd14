/* Hole filling: pixels that are still invalid continue the surface behind the disocclusion or, out of screen, the lines
   at the image's border, or come from the image downsampled 32 times (paper: 'Shading correction network'). Only pixels
   labeled for filling change, and keep their label. RUN pixels without any are skipped at once, and the downsampled
   image is only computed for pixels that need it. */

#include "frame.h"
#include "simd_rgb.h"
#include "color_code.h"
#include "directional_search.h"
#include "blocks.h"

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
    __global const uchar *is_dynamic;
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
#define IN_FRONT 0.98f /* times the depth that is shown: nearer surfaces lie in front of it */

/* The first of `steps` pixels, `offset` apart from each other, that `mask` does not call a `hole`, counted from 1;
   0: none. */
INLINE int first_beside(const int dst, const int offset, const int steps, __global const uchar *mask,
                        const uchar hole) {
    int t = 1;
    for (; t + AT_ONCE <= steps; t += AT_ONCE) {
        bool any = false;
        for (int k = 0; k < AT_ONCE; ++k) any |= mask[dst + (t + k) * offset] != hole;
        if (any) break;
    }
    for (; t <= steps; ++t)
        if (mask[dst + t * offset] != hole) return t;
    return 0;
}

/* Steps from a hole's pixel in row y to the first pixel beside the hole up and down its column; 0: none within reach.
   Holes at the image's border are as long as the image is, and the next row need not look along them again. */
typedef struct {
    int y, up, down;
} Column;

#define NO_ROW -2 /* the `y` of a column before its first one */

/* Goes on from the hole's pixel above. */
INLINE void step_down(const int dst, const int reach, const int width, const int height, __global const uchar *mask,
                      const uchar hole, Column *c) {
    const int last = dst + reach * width;
    const bool comes_near = c->y + 1 + reach < height && mask[last] != hole;
    c->up = c->up && c->up < reach ? c->up + 1 : 0;
    c->down = c->down ? c->down - 1 : comes_near ? reach : 0;
    ++c->y;
}

/* The first pixels beside a hole, in the directions that `met` one: their indices, 1 / distance (1/px), and their
   inverse depths. */
typedef struct {
    int met;
    DirectionInts px;
    DirectionFloats closeness, inverse;
    float least_inverse;
} Border;

/* `column`: that of the row above, if its pixel is one of the hole; becomes this one's. LANES directions at once. */
INLINE void find_border(const int dst_x, const int dst_y, const int width, const int height, const int reach,
                        __global const uchar *mask, const uchar hole, __global const float *depth, Column *column,
                        Border *found) {
    const int dst = dst_y * width + dst_x;
    const bool goes_on = LANES > 1 && column->y == dst_y - 1; /* GPUs have one row per work-item */
    if (goes_on) step_down(dst, reach, width, height, mask, hole, column);
    found->met = 0;
    found->least_inverse = INFINITY;
    for (int k = 0; k < DIRECTIONS; k += LANES) {
        int lane_t[LANES], lane_px[LANES];
        for (int lane = 0; lane < LANES; ++lane) {
            const int2 d = direction(k + lane);
            const int offset = d.y * width + d.x;
            int t;
            if (goes_on && d.x == 0)
                t = d.y > 0 ? column->down : column->up;
            else
                t = first_beside(dst, offset, steps_within(reach, d, dst_x, dst_y, width, height), mask, hole);
            if (d.x == 0 && d.y > 0) column->down = t;
            if (d.x == 0 && d.y < 0) column->up = t;
            lane_t[lane] = t;
            lane_px[lane] = dst + t * offset;
        }
        const Ints t = load_ints(0, lane_t), px = load_ints(0, lane_px), is_met = t > 0;
        const Floats z = gather_floats(depth, px), none = (Floats)(0.0f), one = (Floats)(1.0f);
        const Floats step = ((k + LANE_NUMBERS) & 1) != 0 ? (Floats)(DIAGONAL) : one;
        const Floats inverse = isinf(z) ? none : wide_divide(one, z);
        SET_INTS(found->px, k, px);
        SET_FLOATS(found->inverse, k, is_met ? inverse : (Floats)(INFINITY));
        SET_FLOATS(found->closeness, k, is_met ? wide_divide(one, to_floats(t) * step) : none);
        found->met |= set_of(is_met, k);
        for (int lane = 0; lane < LANES; ++lane)
            if (lane_t[lane]) found->least_inverse = fmin(found->least_inverse, AT(found->inverse, k + lane));
    }
    column->y = dst_y;
}

INLINE Ints is_as_far(const Floats inverse, const Floats other) {
    return !(inverse > other * FAR_SIDE) & !(other > inverse * FAR_SIDE);
}

/* The directions that meet the far side. */
INLINE int far_side(const Border *a) {
    int far = 0;
#pragma unroll
    for (int k = 0; k < DIRECTIONS; k += LANES)
        far |= set_of(!(FLOATS_AT(a->inverse, k) > a->least_inverse * FAR_SIDE), k);
    return far & a->met;
}

DEFINE_COLOR_CODE(Floats, wide_root, wide_encode, wide_decode)

/* A sum that goes on with one lane after another. */
INLINE float sum_of(const float before, const Floats values) {
    float lane_value[LANES], sum = before;
    store_floats(values, 0, lane_value);
#pragma unroll
    for (int lane = 0; lane < LANES; ++lane) sum += lane_value[lane];
    return sum;
}

/* Mean (color, inverse depth) of the pixels in some directions, weighted by their closeness, or by its `square`. */
INLINE float4 weighted_mean(const Border *a, const int directions, const bool square, const float code_offset,
                            __global const half *color) {
    float4 sum = (float4)(0.0f);
    float weight_sum = 0.0f;
    for (int k = 0; k < DIRECTIONS; k += LANES) {
        const Ints is_in = wide_has(directions, k);
        if (!ANY(is_in)) continue;
        const Floats closeness = FLOATS_AT(a->closeness, k), none = (Floats)(0.0f);
        const Floats weight = is_in ? (square ? closeness * closeness : closeness) : none;
        const WideRgb c = finite_rgb(gather_rgb(color, INTS_AT(a->px, k)));
        sum.x = sum_of(sum.x, weight * wide_encode(c.r, code_offset));
        sum.y = sum_of(sum.y, weight * wide_encode(c.g, code_offset));
        sum.z = sum_of(sum.z, weight * wide_encode(c.b, code_offset));
        sum.w = sum_of(sum.w, is_in ? weight * FLOATS_AT(a->inverse, k) : none);
        weight_sum = sum_of(weight_sum, weight);
    }
    return (float4)(decode_color(mean_of(sum.xyz, weight_sum), code_offset), divide(sum.w, weight_sum));
}

/* Where a static pixel is in the rendered image, and its depth there, for LANES inverse depths; z <= 0: behind the
   camera. */
INLINE Wide3 static_source(const int dst_x, const int dst_y, const Floats inverse_depth, const Reprojection to_source) {
    const Floats z = inverse_depth > 0.0f ? wide_divide((Floats)(1.0f), inverse_depth) : (Floats)(INFINITY);
    const float2 px = pixel_center(dst_x, dst_y);
    return wide_reproject((Floats)(px.x), (Floats)(px.y), z, to_source);
}

/* The same for one. */
INLINE float3 static_source_of(const int dst_x, const int dst_y, const float inverse_depth,
                               const Reprojection to_source) {
    const Wide3 px_source = static_source(dst_x, dst_y, (Floats)(inverse_depth), to_source);
    return (float3)(FIRST_LANE(px_source.x), FIRST_LANE(px_source.y), FIRST_LANE(px_source.z));
}

/* Code of the rendered frame's color at `px_source`, or at the place on its border that is closest; bilinear. */
INLINE float3 border_code(const float2 px_source, __constant Frame *frame, __global const half *codes) {
    const int width = frame->source_width, height = frame->source_height;
    const float x = clamp(px_source.x - 0.5f, 0.0f, (float)(width - 1)),
                y = clamp(px_source.y - 0.5f, 0.0f, (float)(height - 1));
    const int x0 = (int)x, y0 = (int)y;
    float3 sum = (float3)(0.0f);
    for (int tap = 0; tap < 4; ++tap) {
        const int src = min(y0 + (tap >> 1), height - 1) * width + min(x0 + (tap & 1), width - 1);
        sum += bilinear_weight(tap, x - (float)x0, y - (float)y0) * stored_code(codes, src);
    }
    return sum;
}

/* Whether places lie outside of the rendered image. */
INLINE Ints is_out_of_screen(const Wide3 px_source, __constant Frame *frame) {
    return !((px_source.z > 0.0f) & (px_source.x >= 0.0f) & (px_source.y >= 0.0f)
             & (px_source.x < (float)frame->source_width) & (px_source.y < (float)frame->source_height));
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
#define SAMPLE_STRIDE 2 /* px between its samples */
#define CELLS_AROUND 3 /* along the border, on either side, over which lines have one direction ... */
#define NEAR 4.0f /* ... those close by count most: one a cell away 1 / (1 + NEAR) */
#define STEEPEST 2.0f /* px along the border, by which lines run on per px out of the image */
#define NOISE 0.0001f /* of the sum of squared changes in a cell, colors displayed as white being 1 */
#define APPROACHES 2 /* of the place where a line leaves the image */
#define FADE 0.4f /* width of the blur per px out of the image, in units of what the lines' direction leaves open */

/* Sums over samples of a cell: products of the changes of color codes in x and y (the structure tensor). */
INLINE void find_lines(const int cell_x, const int cell_y, __constant Frame *frame, __global const half *codes,
                       __global float *border_lines) {
    const int width = frame->source_width, height = frame->source_height;
    const int first_x = max(min(cell_x * CELL, width - CELL), 0) + 1,
              first_y = max(min(cell_y * CELL, height - CELL), 0) + 1;
    float xx = 0.0f, xy = 0.0f, yy = 0.0f;
    for (int y = first_y; y < min(first_y + CELL - 1, height - 1); y += SAMPLE_STRIDE)
        for (int x = first_x; x < min(first_x + CELL - 1, width - 1); x += SAMPLE_STRIDE) {
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
   column of cells that begins at cell `first`. */
INLINE Lines lines_at(const float along, const bool horizontal, const int first, __constant Frame *frame,
                      __global const float *border_lines) {
    const int plane = frame->cells_width * frame->cells_height;
    const int count = horizontal ? frame->cells_width : frame->cells_height, step = horizontal ? 1 : frame->cells_width;
    const float side = (float)(horizontal ? frame->source_width : frame->source_height);
    const float at = clamp(along, 0.0f, side) * (1.0f / CELL) - 0.5f;
    const int low = (int)floor(at);
    float across = 0.0f, both = 0.0f, inward = 0.0f;
    for (int k = max(low - CELLS_AROUND + 1, 0); k <= min(low + CELLS_AROUND, count - 1); ++k) {
        const float off = at - (float)k, part = off * (1.0f / CELLS_AROUND);
        const float window = fmax(1.0f - part * part, 0.0f), weight = divide(window * window, 1.0f + NEAR * off * off);
        const int cell = first + k * step;
        across += weight * border_lines[(horizontal ? 0 : 2 * plane) + cell];
        both += weight * border_lines[plane + cell];
        inward += weight * border_lines[(horizontal ? 2 * plane : 0) + cell];
    }
    const float white = frame->code_offset > 0.0f ? 4.0f * frame->code_offset * frame->code_offset : 1.0f;
    const float sure = across + NOISE * white * white;
    Lines lines;
    lines.slope = clamp(-divide(both, sure), -STEEPEST, STEEPEST);
    const float unexplained = inward + lines.slope * (2.0f * both + lines.slope * across);
    lines.spread = root(divide(fmax(unexplained, 0.0f), sure));
    return lines;
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
        lines = lines_at(along, horizontal, first, frame, f.border_lines);
        along = start + out * lines.slope;
    }
    const float blur = FADE * lines.spread * fabs(out);
    float3 sum = (float3)(0.0f);
    for (int k = -2; k <= 2; ++k) {
        const float at = along + 0.75f * blur * (float)k;
        const float2 place = horizontal ? (float2)(at, px_source.y) : (float2)(px_source.x, at);
        const float weight = k == 0 ? 0.316f : k == 1 || k == -1 ? 0.239f : 0.103f;
        sum += weight * border_code(place, frame, f.codes);
    }
    return decode_color(sum, frame->code_offset);
}

/* Whether surfaces can be at places `inside` of the rendered frame: not in front of those that the frame shows
   there. */
INLINE Ints can_be_at(const Ints inside, const Wide3 px_source, __constant Frame *frame,
                      __global const float *source_depth) {
    const Floats none = (Floats)(0.0f);
    const Ints x = to_ints(inside ? px_source.x : none), y = to_ints(inside ? px_source.y : none);
    const Floats shown = gather_floats(source_depth, y * frame->source_width + x);
    return inside & !INVALID_DEPTH(shown) & !(px_source.z < IN_FRONT * shown);
}

/* The directions that meet the surface behind a disocclusion. Candidates, `behind`, are static surfaces that,
   continued into the disocclusion, can be there in the rendered frame. Of these, the surface with the largest sum of
   inverse distances counts; without candidates the far side. */
INLINE int surface_behind(const Border *a, const int behind) {
    if (!behind) return far_side(a);
    float most = 0.0f, inverse = 0.0f;
    for (int j = 0; j < DIRECTIONS; j += LANES) {
        const Floats inverse_j = FLOATS_AT(a->inverse, j), none = (Floats)(0.0f);
        Floats sum = none;
#pragma unroll
        for (int k = 0; k < DIRECTIONS; ++k)
            if (has(behind, k))
                sum += is_as_far(inverse_j, (Floats)(AT(a->inverse, k))) ? (Floats)(AT(a->closeness, k)) : none;
        float lane_sum[LANES];
        store_floats(sum, 0, lane_sum);
        for (int lane = 0; lane < LANES; ++lane) {
            if (!has(behind, j + lane) || !(lane_sum[lane] > most)) continue;
            most = lane_sum[lane];
            inverse = AT(a->inverse, j + lane);
        }
    }
    int counts = 0;
#pragma unroll
    for (int k = 0; k < DIRECTIONS; k += LANES)
        counts |= set_of(is_as_far(FLOATS_AT(a->inverse, k), (Floats)(inverse)), k);
    return counts & behind;
}

/* Continues the surfaces of the first valid pixels in eight directions, up to `reach` px away: a surface that,
   continued into the hole, lies outside of the rendered image was hidden by nothing. If there are such, the hole is
   theirs: its depth is the mean of theirs, in which those close by count most, its color that of lines at the border.
   Else it is a disocclusion, and shows the surface behind it. Gives (color, inverse depth); false where no direction
   meets a valid pixel. */
INLINE bool continue_surface(const int dst_x, const int dst_y, __constant Frame *frame, const Images f, Column *column,
                             float4 *mean) {
    const int width = frame->target_width, reach = max(LEAST_REACH, width / REACH_SHARE);
    Border a;
    find_border(dst_x, dst_y, width, frame->target_height, reach, f.filled_by, BY_HOLE_FILLING, f.depth, column, &a);
    if (!a.met) return false;
    int out_of_screen = 0, behind = 0;
    for (int k = 0; k < DIRECTIONS; k += LANES) {
        const Ints is_met = wide_has(a.met, k), px = INTS_AT(a.px, k);
        if (!ANY(is_met)) continue;
        const Wide3 px_source = static_source(dst_x, dst_y, FLOATS_AT(a.inverse, k), frame->to_source);
        const Ints is_outside = is_out_of_screen(px_source, frame);
        out_of_screen |= set_of(is_met & is_outside, k);
        behind |= set_of(can_be_at(is_met & !is_outside, px_source, frame, f.source_depth)
                             & (to_ints(gather_bytes(f.is_dynamic, px)) == 0)
                             & (to_ints(gather_bytes(f.filled_by, px)) != BY_HIDDEN_PART),
                         k);
    }
    const bool is_disocclusion = !out_of_screen;
    *mean = weighted_mean(&a, is_disocclusion ? surface_behind(&a, behind) : out_of_screen, !is_disocclusion,
                          frame->code_offset, f.color);
    const float3 px_source = static_source_of(dst_x, dst_y, mean->w, frame->to_source);
    if (!is_disocclusion && px_source.z > 0.0f) mean->xyz = color_beyond(px_source.xy, frame, f);
    return true;
}

#define MIXED_REACH 16 /* px beyond which the far side does not represent the remembered surface */
#define CONTRAST 0.4f /* of the far side, relative to its mean, with which it counts half */

INLINE float brightness(const float3 c) { return (c.x + c.y + c.z) * (1.0f / 3.0f); }

/* Weight of the far side's `mean` relative to a remembered color. It grows if the far side is near and uniform. */
INLINE float weight_of_far_side(const Border *a, const int far, const float3 mean, __global const half *color) {
    float closest = 0.0f, sum = 0.0f, weight_sum = 0.0f;
    for (int k = 0; k < DIRECTIONS; ++k) {
        if (!has(far, k)) continue;
        const float off = brightness(load_color(color, AT(a->px, k)) - mean), closeness = AT(a->closeness, k);
        closest = fmax(closest, closeness);
        sum += closeness * off * off;
        weight_sum += closeness;
    }
    const float typical = CONTRAST * brightness(mean), uniform = typical * typical, spread = divide(sum, weight_sum);
    return spread > 0.0f ? closest * divide(uniform, uniform + spread) : closest;
}

/* Mixes a fill of the background with the far side. A surface's remembered color may be out of date, so the weighted
   mean with the present color beside it is shown. */
INLINE void mix_far_side(const int dst_x, const int dst_y, __constant Frame *frame, __global const uchar *disoccluded,
                         __global const float *depth, __global half *color) {
    const int width = frame->target_width, dst = dst_y * width + dst_x;
    Border a;
    Column column = {.y = NO_ROW};
    find_border(dst_x, dst_y, width, frame->target_height, MIXED_REACH, disoccluded, 1, depth, &column, &a);
    if (!a.met) return;
    const int far = far_side(&a);
    const float3 mean = weighted_mean(&a, far, false, frame->code_offset, color).xyz;
    const float counts = weight_of_far_side(&a, far, mean, color);
    const float3 sum = load_code(color, dst, frame->code_offset) + counts * encode_color(mean, frame->code_offset);
    store_code(mean_of(sum, 1.0f + counts), color, dst, frame->code_offset);
}

/* Two preparations for fill_far_side, which do not touch each other's buffers. Lines at the image's border, but not
   under a camera that stays, which has nothing out of screen. And the background's fills are mixed with the far side,
   RUN pixels per work-item. */
SCAN __kernel void prepare_far_side(__constant Frame *restrict frame, __global const half *codes,
                                    __global const uchar *disoccluded, __global const uchar *filled_by,
                                    __global const float *depth, __global half *color, __global float *border_lines) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int first_x = get_global_id(0) * RUN, dst_y = get_global_id(1);
    if (first_x >= target_width || dst_y >= target_height) return;
    const int columns = (target_width + RUN - 1) / RUN;
    if (!frame->stays)
        find_border_lines(dst_y * columns + first_x / RUN, columns * target_height, frame, codes, border_lines);
    const int first = dst_y * target_width + first_x;
    if (!frame->collects || (first_x + RUN <= target_width && run_is_zero(disoccluded + first))) return;
    for (int dst_x = first_x; dst_x < min(first_x + RUN, target_width); ++dst_x) {
        const int dst = dst_y * target_width + dst_x;
        if (disoccluded[dst] && filled_by[dst] != BY_HOLE_FILLING && !IS_OF_MOVER(filled_by[dst]))
            mix_far_side(dst_x, dst_y, frame, disoccluded, depth, color);
    }
}

/* ---- fill ------------------------------------------------------------------------------------------------------ */

/* Fills a pixel's depth, and the motion of a static point. Gives where that is in the rendered image
   (static_source). */
INLINE float3 fill_geometry(const int dst_x, const int dst_y, const float inverse_depth, __constant Frame *frame,
                            const Images f) {
    const int dst = dst_y * frame->target_width + dst_x;
    const float3 px_source = static_source_of(dst_x, dst_y, inverse_depth, frame->to_source);
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

/* Fills pixels that are still invalid from the far side. RUN x LANES pixels per work-item. */
SCAN __kernel void fill_far_side(__constant Frame *restrict frame, __global const uchar *block_class,
                                 __global const uchar *filled_by, __global const half *codes,
                                 __global const float *source_depth, __global const uchar *is_dynamic,
                                 __global const float *border_lines, __global half *color, __global float *depth,
                                 __global float2 *motion) {
    const Images images = {.filled_by = filled_by,
                           .codes = codes,
                           .source_depth = source_depth,
                           .is_dynamic = is_dynamic,
                           .border_lines = border_lines,
                           .color = color,
                           .depth = depth,
                           .motion = motion};
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int first_x = get_global_id(0) * RUN, first_y = get_global_id(1) * LANES;
    if (first_x >= target_width || first_y >= target_height) return;
    const int rows = LANES == 1 ? 1 : min(LANES, target_height - first_y); /* GPUs' compilers unroll that */
    Column columns[RUN];
    for (int k = 0; k < RUN; ++k) columns[k].y = NO_ROW;
    for (int row = 0; row < rows; ++row) {
        const int dst_y = first_y + row, first = dst_y * target_width + first_x;
        if (run_is_backward(first_x, dst_y, target_width, block_class)) continue;
        if (first_x + RUN <= target_width && !run_has(filled_by + first, BY_HOLE_FILLING)) continue;
        for (int dst_x = first_x; dst_x < min(first_x + RUN, target_width); ++dst_x) {
            const int dst = dst_y * target_width + dst_x;
            if (filled_by[dst] != BY_HOLE_FILLING) continue;
            float4 mean;
            if (continue_surface(dst_x, dst_y, frame, images, columns + (dst_x - first_x), &mean))
                fill_pixel(dst_x, dst_y, mean, frame, images);
            else
                depth[dst] = BEYOND_REACH;
        }
    }
}

/* ---- downsampled, as in the paper ------------------------------------------------------------------------------ */

#define TILE 4 /* texels along the side of a work-group's area: it needs those around them, too */
#define RING (TILE + 2)
#define GROUP 128 /* work-items of it: one per row of pixels, or DOWNSAMPLING columns of strips */
#define STRIP 8 /* rows of a texel that one work-item sums up */

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

/* Weighted sums, (color, 1) and inverse depth, over STRIP rows of a column: of valid pixels, and a little of the
   rendered frame. */
INLINE float4 sum_strip(const int dst_x, const int first_y, __constant Frame *frame, const Images f,
                        float *inverse_sum) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int source_width = frame->source_width, source_height = frame->source_height;
    float4 sum = (float4)(0.0f);
    *inverse_sum = 0.0f;
    if (dst_x >= target_width) return sum;
    for (int dst_y = first_y; dst_y < min(first_y + STRIP, target_height); ++dst_y) {
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
    const Wide3 place = {(Floats)(px_source.x), (Floats)(px_source.y), (Floats)(px_source.z)};
    if (tile.after_far_side && ANY(is_out_of_screen(place, frame)))
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

/* Fills the rest from the image downsampled 32x, interpolated. Every work-group fills the pixels under TILE x TILE
   texels: it sums up those of them, and of the ring around them, that its pixels ask for. The sums are kept for who
   wants to look at them. */
SPARSE __kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
fill_from_downsampled(__constant Frame *restrict frame, const int after_far_side, __global const uchar *filled_by,
                      __global const half *codes, __global const half *source_color, __global const float *source_depth,
                      __global half *color, __global float *depth, __global float2 *motion,
                      __global float4 *downsampled_color, __global float *downsampled_inverse_depth) {
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
    barrier(CLK_LOCAL_MEM_FENCE);
    fill_or_ask(false, first_x, end_x, dst_y, tile, frame, images);
    barrier(CLK_LOCAL_MEM_FENCE);

    if (!any_asks) return;

    for (int k = 0; k < RING * RING; ++k) {
        if (!asked[k]) continue;
        float inverse_sum;
        strip_sums[lane] = sum_strip((tile.ring_x + k % RING) * DOWNSAMPLING + lane % DOWNSAMPLING,
                                     (tile.ring_y + k / RING) * DOWNSAMPLING + lane / DOWNSAMPLING * STRIP, frame,
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
