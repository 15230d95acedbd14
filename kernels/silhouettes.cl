/* Silhouettes: edges of objects that move over others, as soft as in the rendered frame. A rendered frame is
   antialiased: a pixel at a silhouette holds a share of the nearer surface, its coverage, and of the surface behind.
   Where both move apart, that share is estimated and carried along with the nearer surface, over the new frame
   behind it. Colors are mixed by their codes (color_code.h). Only pixels at steps of depth whose two sides move
   apart are looked at; LANES of others are skipped at once. */

#include "frame.h"
#include "flow.h"
#include "blocks.h"
#include "lists.h"
#include "color_code.h"
#include "layers.h"

/* What set the thresholds: docs/deviations.md, "Silhouettes stay antialiased". */
#define SAME_LAYER 0.85f     /* least ratio of the depths of fragments of one layer */
#define ALONG 0.7f           /* px by which fragments of a layer may deviate from its motion */
#define SHARPER 0.5f        /* by how much coverage is steepened, which interpolation midway between pixels smooths */

INLINE float3 not_negative(const float3 c) { return fmax(c, 0.0f); }

/* The new frame: every pixel shows the point of the rendered frame that its motion points to. */
typedef struct {
    int width, height;
    float code_offset;
    __global const half *color;
    __global const float *depth;
    __global const float2 *motion;
    __global const uchar *filled_by;
} Shown;

/* The rendered frame's layers. */
typedef struct {
    __global const uchar *layer;
    __global const uint *behind;
    __global const uchar *share;
} Layers;

INLINE bool is_warped(const uchar filled_by) { return filled_by == BY_WARP || filled_by == BY_CRACK_CLOSING; }

/* Whether the fragment at (x, y) goes to depth z, and to `px`, by its place in the rendered image, `px_source`. */
INLINE bool goes_along(const Source s, const int x, const int y, const float3 there, const float2 px,
                       const float2 px_source, const float z) {
    const float2 center = pixel_center(x, y);
    const float ex = there.x - px.x - s.zoom.x * (center.x - px_source.x),
                ey = there.y - px.y - s.zoom.y * (center.y - px_source.y);
    return there.z * SAME_LAYER <= z && z * SAME_LAYER <= there.z && fmax(fabs(ex), fabs(ey)) < ALONG;
}

/* Whether a pixel's color includes that of a nearer layer; (x0, y0): the first of the four pixels around its place. */
INLINE bool is_mixed_with_near(const Source s, const Layers l, const int x0, const int y0) {
    for (int k = 0; k < 4; ++k) {
        const int x = x0 + (k & 1), y = y0 + (k >> 1);
        if (inside(x, y, s.width, s.height) && l.layer[y * s.width + x] == FAR) return true;
    }
    return false;
}

/* The far layer around `px_source` of the rendered frame, of pixels that go to `px` at depth z: their colors, without
   that of a nearer layer, times their bilinear weights, and the weights. */
INLINE float4 far_layer(const Source s, const Layers l, const float2 px, const float2 px_source, const float z) {
    const int x0 = (int)floor(px_source.x - 0.5f), y0 = (int)floor(px_source.y - 0.5f);
    const float u = px_source.x - 0.5f - (float)x0, v = px_source.y - 0.5f - (float)y0;
    float4 sum = (float4)(0.0f);
    for (int k = 0; k < 4; ++k) {
        const int x = x0 + (k & 1), y = y0 + (k >> 1), src = y * s.width + x;
        if (!inside(x, y, s.width, s.height)) continue;
        const float3 there = position_of(s.target_position, src, s.width * s.height);
        if (!goes_along(s, x, y, there, px, px_source, z)) continue;
        sum += bilinear_weight(k, u, v)
               * (float4)(l.layer[src] == FAR ? unpack_color(l.behind[src]) : stored_code(s.codes, src), 1.0f);
    }
    return sum;
}

/* Color of a pixel without that of a nearer layer that was mixed into it; false if there is none in it. */
INLINE bool without_near(const Source s, const Layers l, const Shown f, const int dst_x, const int dst_y, float3 *rgb) {
    const int dst = dst_y * f.width + dst_x;
    if (!is_warped(f.filled_by[dst])) return false;
    const float2 px = pixel_center(dst_x, dst_y), px_source = px + f.motion[dst];
    if (!is_mixed_with_near(s, l, (int)floor(px_source.x - 0.5f), (int)floor(px_source.y - 0.5f))) return false;
    const float4 sum = far_layer(s, l, px, px_source, f.depth[dst]);
    if (sum.w > 0.05f) *rgb = mean_of(sum.xyz, sum.w);
    return sum.w > 0.05f;
}

/* The near layer at `px_source` of the rendered frame, bilinear and sharpened: (its color times its coverage, its
   coverage). False if it is not known: out of the image, or hidden by something else. */
INLINE bool near_layer(const Source s, const Layers l, const float2 px, const float2 px_source, const float z,
                       float4 *near) {
    const int x0 = (int)floor(px_source.x - 0.5f), y0 = (int)floor(px_source.y - 0.5f);
    const float u = px_source.x - 0.5f - (float)x0, v = px_source.y - 0.5f - (float)y0;
    float4 sum = (float4)(0.0f);
    float weight_sum = 0.0f;
    for (int k = 0; k < 4; ++k) {
        const int x = x0 + (k & 1), y = y0 + (k >> 1), src = y * s.width + x;
        if (!inside(x, y, s.width, s.height)) continue;
        const float3 there = position_of(s.target_position, src, s.width * s.height);
        const bool along = goes_along(s, x, y, there, px, px_source, z);
        if (!along && there.z > 0.0f && there.z < z) continue;
        const uchar layer = l.layer[src];
        const float weight = bilinear_weight(k, u, v);
        weight_sum += weight;
        if (along && layer != NEAR) {
            sum +=
                weight
                * (float4)(layer == FAR ? unpack_color(l.behind[src]) : not_negative(stored_code(s.codes, src)), 1.0f);
        } else if (along || layer == FAR) {
            const float share = (float)l.share[src] * (1.0f / SHARES);
            const float3 own = not_negative(stored_code(s.codes, src));
            sum += weight * (float4)(not_negative(own - (1.0f - share) * unpack_color(l.behind[src])), share);
        }
    }
    if (!(weight_sum > 0.5f)) return false;
    const float steep = 1.0f + SHARPER * (1.0f - fabs(2.0f * u - 1.0f) * fabs(2.0f * v - 1.0f));
    const float coverage = clamp(steep * (divide(sum.w, weight_sum) - 0.5f) + 0.5f, 0.0f, 1.0f);
    *near = (float4)(sum.xyz * (coverage > 0.0f ? divide(coverage, sum.w) : 0.0f), coverage);
    return true;
}

/* The two layers around pixels of the new frame, on both sides of a depth halfway: where the near one lies in the
   rendered image, continued to a pixel's center, how deep it is, and which of the 3x3 pixels around show the far
   one, in bits. */
typedef struct {
    Floats near_x, near_y, near_z;
    Ints far;
} LayerPairs;

/* Gives which of LANES pixels lie between two layers that move apart. A layer's place is that of the pixel itself if it
   shows the layer, else the mean of its neighbors', or of its corners' without any. */
INLINE Ints find_pairs(const Span p, const Source s, const Shown f, LayerPairs *pairs) {
    Depths d;
    load_depths(p, f.depth, &d);
    if (!ANY(at_step(&d))) return (Ints)(0);
    const float back_x = divide(1.0f, s.zoom.x), back_y = divide(1.0f, s.zoom.y);
    Floats x[9], y[9], low_x = INFINITY, high_x = -INFINITY, low_y = INFINITY, high_y = -INFINITY;
    Ints warped[9];
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1;
        const Floats motion_x = xy_beside(p, f.motion, dx, dy, y + k);
        x[k] = row_centers(p.x + dx) + motion_x - back_x * (float)dx;
        y[k] = (float)(p.y + dy) + 0.5f + y[k] - back_y * (float)dy;
        low_x = x[k] < low_x ? x[k] : low_x;
        high_x = x[k] > high_x ? x[k] : high_x;
        low_y = y[k] < low_y ? y[k] : low_y;
        high_y = y[k] > high_y ? y[k] : high_y;
    }
    if (!ANY((high_x - low_x > MOVES_APART) | (high_y - low_y > MOVES_APART))) return (Ints)(0);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1;
        const Ints filled_by = bytes_beside(p, f.filled_by, dx, dy);
        d.z[k] = (is_inside(p, dx, dy) & (filled_by != BY_NOTHING)) ? d.z[k] : (Floats)(0.0f);
        warped[k] = (filled_by == BY_WARP) | (filled_by == BY_CRACK_CLOSING);
    }
    const Ints step = at_step(&d);
    const Floats none = (Floats)(0.0f);
    Floats near_x = none, near_y = none, near_z = none, near_count = none, far_x = none, far_y = none, far_count = none;
    Ints near_known = (Ints)(0), far_known = (Ints)(0), far = (Ints)(0);
#pragma unroll
    for (int i = 0; i < 9; ++i) {
        const int k = i == 0 ? 4 : i < 5 ? 2 * i - 1 : i < 7 ? 2 * i - 10 : 2 * i - 8; /* corners last */
        if (i == 1 || i == 5) {
            near_known = near_count > 0.0f;
            far_known = far_count > 0.0f;
        }
        const Ints is_near = d.z[k] < d.middle, shown = d.z[k] > 0.0f;
        const Ints is_of_near = shown & is_near & warped[k] & !near_known, is_of_far = shown & !is_near & !far_known;
        near_x += is_of_near ? x[k] : none;
        near_y += is_of_near ? y[k] : none;
        near_z += is_of_near ? d.z[k] : none;
        near_count += is_of_near ? (Floats)(1.0f) : none;
        far_x += is_of_far ? x[k] : none;
        far_y += is_of_far ? y[k] : none;
        far_count += is_of_far ? (Floats)(1.0f) : none;
        far |= is_of_far ? (Ints)(1 << k) : (Ints)(0);
    }
    pairs->near_x = wide_divide(near_x, near_count);
    pairs->near_y = wide_divide(near_y, near_count);
    pairs->near_z = wide_divide(near_z, near_count);
    pairs->far = far;
    const Floats apart_x = fabs(pairs->near_x - wide_divide(far_x, far_count));
    const Floats apart_y = fabs(pairs->near_y - wide_divide(far_y, far_count));
    return step & (d.z[4] > 0.0f) & (near_count > 0.0f) & (far_count > 0.0f)
           & ((apart_x > MOVES_APART) | (apart_y > MOVES_APART));
}

/* Color of the far layer at a pixel, which the 3x3 pixels in `far` show: the pixel's own. If it shows the near one,
   that which the rendered frame has where their motion, continued to the pixel, points to; as far as it is hidden
   there, the mean of theirs. */
INLINE float3 far_color(const Source s, const Layers l, const Shown f, const int dst_x, const int dst_y,
                        const int far) {
    const float count = (float)popcount(far);
    float4 seen = (float4)(0.0f);
    if (!(far & 1 << 4)) {
        const float2 back = (float2)(1.0f - divide(1.0f, s.zoom.x), 1.0f - divide(1.0f, s.zoom.y));
        float2 motion = (float2)(0.0f);
        float z = 0.0f;
        for (int left = far; left; left &= left - 1) {
            const int k = 31 - clz(left & -left), dx = k % 3 - 1, dy = k / 3 - 1;
            const int dst = (dst_y + dy) * f.width + dst_x + dx;
            motion += f.motion[dst] + back * (float2)((float)dx, (float)dy);
            z = fmax(z, f.depth[dst]);
        }
        const float2 px = pixel_center(dst_x, dst_y);
        seen = far_layer(s, l, px, px + (float2)(divide(motion.x, count), divide(motion.y, count)), z);
        if (seen.w > 0.99f) return mean_of(seen.xyz, seen.w);
    }
    float3 sum = (float3)(0.0f);
    for (int left = far; left; left &= left - 1) {
        const int k = 31 - clz(left & -left);
        const int x = dst_x + k % 3 - 1, y = dst_y + k / 3 - 1;
        float3 rgb;
        if (!without_near(s, l, f, x, y, &rgb)) rgb = load_code(f.color, y * f.width + x, f.code_offset);
        sum += rgb;
    }
    return seen.xyz + (1.0f - seen.w) * mean_of(sum, count);
}

/* Value of `coverage` of a pixel, 0 if it is unchanged; else stores its color. `near_place`, `far`: of its pair of
   layers; 0: it has none. */
INLINE uchar soften_pixel(const Source s, const Layers l, const Shown f, const int dst_x, const int dst_y,
                          const float3 near_place, const int far, __global uint *softened) {
    const int dst = dst_y * f.width + dst_x;
    float4 near;
    float3 rgb;
    if (far && near_layer(s, l, pixel_center(dst_x, dst_y), near_place.xy, near_place.z, &near)) {
        softened[dst] = pack_color(near.xyz + (1.0f - near.w) * far_color(s, l, f, dst_x, dst_y, far));
        return (uchar)(1.0f + 254.0f * near.w + 0.5f);
    }
    if (!without_near(s, l, f, dst_x, dst_y, &rgb)) return 0;
    softened[dst] = pack_color(rgb);
    return 1;
}

/* Gives which of LANES pixels may show pixels of a far layer. */
INLINE Ints may_be_mixed(const Span p, const Source s, const Layers l, const Shown f) {
    if (!p.inner) return (Ints)(-1);
    Floats motion_y;
    const Floats motion_x = load_xy(f.motion + p.y * p.width + p.x, &motion_y);
    const Floats px_x = row_centers(p.x) + motion_x - 0.5f, px_y = (float)p.y + 0.5f + motion_y - 0.5f;
    const Ints in_image =
        (px_x >= 0.0f) & (px_y >= 0.0f) & (px_x < (float)(s.width - 1)) & (px_y < (float)(s.height - 1));
    if (!ALL(in_image)) return (Ints)(-1);
    const Ints taps = to_ints(px_y) * s.width + to_ints(px_x);
    const int first = FIRST_LANE(taps);
    const bool is_run = ALL(taps == first + LANE_NUMBERS);
    Ints mixed = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        __global const uchar *layer = l.layer + (k >> 1) * s.width + (k & 1);
        mixed |= to_ints(is_run ? load_bytes(0, layer + first) : gather_bytes(layer, taps)) == FAR;
    }
    return mixed;
}

/* Gives which of LANES pixels are soft: they lie between layers, then `pairs` tells and `paired` is set, or show pixels
   of a far one. */
INLINE Ints find_soft(const int dst_x, const int dst_y, const Source s, const Layers l, const Shown f,
                      LayerPairs *pairs, Ints *paired) {
    Span p = span_at(dst_x, dst_y, f.width, f.height);
    if (LANES > 1 && p.inner) { /* without tests of the border; a single lane has no registers for both */
        p.inner = true;
        *paired = find_pairs(p, s, f, pairs);
    } else {
        *paired = find_pairs(p, s, f, pairs);
    }
    return (*paired != 0) | may_be_mixed(p, s, l, f);
}

#if LANES == 1
/* The group's pixels, a block after the other, so that one without a mark costs nothing; then those that are soft,
   which are gathered in `held`: (the near layer's place and depth, its far one << SOFT_BITS | number of the pixel). */
#define SOFT_BITS 7 /* of the number of a work-item of a group, of 16x8 */
INLINE void soften_pixels(const Source s, const Layers l, const Shown f, __global const uchar *marked,
                          __global uint *softened, __global uchar *coverage, __global uint *soft, __local int4 *held,
                          __local uint *shared) {
    const int column = get_local_id(0), row = get_local_id(1), item = 16 * row + column;
    const int group_x = get_global_id(0) - column, group_y = get_global_id(1) - row;
    const int x = 4 * (row & 2) + column % 8, y = (row & 4) + 2 * (row & 1) + column / 8;
    const int dst_x = group_x + x, dst_y = group_y + y;
    if (item == 0) shared[0] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (inside(dst_x, dst_y, f.width, f.height) && marked[block_of(dst_x, dst_y, f.width)]) {
        LayerPairs pairs = {0.0f, 0.0f, 0.0f, 0};
        Ints paired;
        if (find_soft(dst_x, dst_y, s, l, f, &pairs, &paired))
            held[atomic_inc(shared)] =
                (int4)(floats_as_ints(pairs.near_x), floats_as_ints(pairs.near_y), floats_as_ints(pairs.near_z),
                       (paired ? pairs.far << SOFT_BITS : 0) | (y << 4) | x);
        else
            coverage[dst_y * f.width + dst_x] = 0;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    const bool is_held = item < (int)shared[0];
    barrier(CLK_LOCAL_MEM_FENCE);
    uchar covered = 0;
    int dst = 0;
    if (is_held) {
        const int4 own = held[item];
        const int soft_x = group_x + (own.w & 15), soft_y = group_y + (own.w >> 4 & 7);
        dst = soft_y * f.width + soft_x;
        covered = soften_pixel(s, l, f, soft_x, soft_y, as_float4(own).xyz, own.w >> SOFT_BITS, softened);
        coverage[dst] = covered;
    }
    append_lanes(covered != 0, (uint)dst, soft, shared);
}
#else
#define SOFT_BITS 0 /* nothing is shared */
INLINE void soften_pixels(const Source s, const Layers l, const Shown f, __global const uchar *marked,
                          __global uint *softened, __global uchar *coverage, __global uint *soft, __local int4 *held,
                          __local uint *shared) {
    (void)held, (void)shared;
    const int dst_x = get_global_id(0) * LANES, dst_y = get_global_id(1), count = min(f.width - dst_x, LANES);
    if (dst_x >= f.width || dst_y >= f.height || !marked[block_of(dst_x, dst_y, f.width)]) return;
    LayerPairs pairs = {0.0f, 0.0f, 0.0f, (Ints)(0)};
    Ints paired;
    const Ints is_soft = find_soft(dst_x, dst_y, s, l, f, &pairs, &paired);
    Bytes covered = 0;
    for (int k = 0; ANY(is_soft) && k < count; ++k) {
        if (!int_of(&is_soft, k)) continue;
        const float3 near =
            (float3)(float_of(&pairs.near_x, k), float_of(&pairs.near_y, k), float_of(&pairs.near_z, k));
        const int far = int_of(&paired, k) ? int_of(&pairs.far, k) : 0;
        const uchar own = soften_pixel(s, l, f, dst_x + k, dst_y, near, far, softened);
        set_byte(&covered, k, own);
        if (own) append((uint)(dst_y * f.width + dst_x + k), soft);
    }
    store_some_bytes(covered, count, coverage + dst_y * f.width + dst_x);
}
#endif

/* The new colors, and `coverage`: 0 where a pixel is unchanged, else 1 + 254 times the nearer layer's share.
   Unmarked blocks are skipped. Lists the pixels that change. */
LISTS __kernel void soften(__constant Frame *restrict frame, __global const uchar *marked,
                           __global const float *target_position, __global const half *codes,
                           __global const uchar *layer, __global const uint *behind, __global const uchar *share,
                           __global const half *color, __global const float *depth, __global const float2 *motion,
                           __global const uchar *filled_by, __global uchar *coverage, __global uint *softened,
                           __global uint *soft) {
    const Source s = source_of(frame, target_position, codes);
    const Layers l = {.layer = layer, .behind = behind, .share = share};
    const Shown f = {.width = frame->target_width,
                     .height = frame->target_height,
                     .code_offset = frame->code_offset,
                     .color = color,
                     .depth = depth,
                     .motion = motion,
                     .filled_by = filled_by};
    __local int4 held[1 << SOFT_BITS];
    __local uint shared[2];
    soften_pixels(s, l, f, marked, softened, coverage, soft, held, shared);
}

/* The new colors go to the frame. */
WALK __kernel void apply_softened(__constant Frame *restrict frame, __global const uint *soft,
                                  __global const uint *softened, __global half *color) {
    for (uint i = get_global_id(0); i < soft[0]; i += get_global_size(0)) {
        const int dst = (int)LISTED(soft, i);
        store_code(unpack_color(softened[dst]), color, dst, frame->code_offset);
    }
}
