/* Silhouettes: edges of what moves over something else, as soft as the rendered frame has them.
   A rendered frame is antialiased: a pixel at a silhouette holds a share of the nearer surface, its coverage, and what it covers.
   Where both move apart, that share is estimated and carried along with the nearer surface, over what the new frame shows behind.
   Only pixels at steps of depth whose two sides move apart are looked at; LANES of others are skipped at once. */

#include "common.h"
#include "wide.h"
#include "cubic.h"
#include "flow.h"
#include "blocks.h"

#define STEP 0.05f           /* relative step of inverse depth between two layers */
#define MOVES_APART 0.5f     /* px: layers that deviate less are resampled together */
#define SAME_LAYER 0.85f     /* least ratio of the depths of fragments of one layer */
#define ALONG 3.0f           /* px by which fragments of a layer may deviate from its motion ... */
#define ALIKE 1.0f           /* ... and those from which one colour is interpolated */
#define BESIDE_OTHER 0.05f   /* weight of colours next to the other layer, which may be mixed, too */
#define TOO_ALIKE 0.02f      /* squared relative contrast of two layers below which colours do not tell the coverage */

/* Values of `layer`: the pixel belongs to one of two layers around it that move apart. */
#define NO_LAYER 0
#define FAR 1
#define NEAR 2

/* Weight of pixel k of 3x3 in the middle one's coverage: a pixel's area, filtered over two. */
inline float tent(const int k) { return k == 4 ? 4.0f : (k & 1) ? 2.0f : 1.0f; }

/* Depth between that of two layers, halfway in inverse depth. */
inline float between(const float nearest, const float farthest) {
    return isinf(farthest) ? 2.0f * nearest : 2.0f * nearest * divide(farthest, nearest + farthest);
}

inline bool is_step(const float nearest, const float farthest) { return nearest < (1.0f - STEP) * farthest; }

/* Least and greatest of what was met so far, lane by lane. */
typedef struct { Floats low, high; } Range;

INLINE void widen(Range *range, const Floats v) {
    range->low = v < range->low ? v : range->low;
    range->high = v > range->high ? v : range->high;
}

/* Which of LANES pixels, one pixel within an image, lie at a step of depth. */
INLINE Ints wide_is_step(__global const float *depth, const int i, const int width) {
    Range range = {(Floats)(INFINITY), (Floats)(0.0f)};
#pragma unroll
    for (int k = 0; k < 9; ++k) widen(&range, load_floats(0, depth + i + (k / 3 - 1) * width + k % 3 - 1));
    return range.low < (1.0f - STEP) * range.high;
}

inline float3 not_negative(const float3 c) { return fmax(c, 0.0f); }

/* ---- layers of the rendered frame ------------------------------------------------------------------------------ */

/* The rendered frame, and where its fragments go. */
typedef struct {
    int width, height;
    float2 zoom;
    __global const float *target_position;
    __global const half *color;
} Source;

/* The 5x5 pixels around (x, y), clamped to the image, in bits: `valid` those that hold a depth, `near` those that are nearer than
   `middle`. */
#define PIXEL_OF_3X3(k) (6 + (k) % 3 + (k) / 3 * 5)
typedef struct { uint valid, near; } Sides;

inline int pixel_beside(const Source s, const int x, const int y, const int dx, const int dy) {
    return clamp(y + dy, 0, s.height - 1) * s.width + clamp(x + dx, 0, s.width - 1);
}

inline Sides sides_of(const Source s, const int x, const int y, const float middle, __global const float *depth) {
    Sides sides = {0, 0};
    for (int k = 0; k < 25; ++k) {
        const float z = depth[pixel_beside(s, x, y, k % 5 - 2, k / 5 - 2)];
        sides.valid |= (uint)!INVALID_DEPTH(z) << k;
        sides.near |= (uint)(z < middle) << k;
    }
    sides.near &= sides.valid;
    return sides;
}

/* Whether bit k and those of the pixels beside it are alike. */
inline bool is_pure(const uint near, const int k) {
    const uint cross = 1u << (k - 5) | 7u << (k - 1) | 1u << (k + 5);
    return (near & cross) == 0 || (near & cross) == cross;
}

/* Whether two layers around (x, y), on both sides of depth *middle, move apart. */
inline bool layers_part(const Source s, const int x, const int y, __global const float *depth, float *middle) {
    const int src = y * s.width + x, plane = s.width * s.height;
    const float3 here = position_of(s.target_position, src, plane);
    if (INVALID_DEPTH(depth[src]) || !(here.z > 0.0f)) return false;
    float nearest = INFINITY, farthest = 0.0f;
    for (int k = 0; k < 9; ++k) {
        const float z = depth[pixel_beside(s, x, y, k % 3 - 1, k / 3 - 1)];
        if (INVALID_DEPTH(z)) continue;
        nearest = fmin(nearest, z);
        farthest = fmax(farthest, z);
    }
    if (!is_step(nearest, farthest)) return false;
    *middle = between(nearest, farthest);
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1, beside = src + dy * s.width + dx;
        if (!inside(x + dx, y + dy, s.width, s.height) || INVALID_DEPTH(depth[beside])) continue;
        if ((depth[beside] < *middle) == (depth[src] < *middle)) continue;
        const float3 there = position_of(s.target_position, beside, plane);
        const float ex = there.x - here.x - s.zoom.x * (float)dx, ey = there.y - here.y - s.zoom.y * (float)dy;
        if (there.z > 0.0f && fmax(fabs(ex), fabs(ey)) > MOVES_APART) return true;
    }
    return false;
}

/* The nearer layer's share of pixel (x, y), and the colour of what it covers: where the pixel's colour lies between the mean
   colours of both layers around, as far as these differ; else from the pixels that each layer has. */
inline float4 unmix(const Source s, const int x, const int y, const float middle, __global const float *depth) {
    const Sides sides = sides_of(s, x, y, middle, depth);
    float4 near_sum = (float4)(0.0f), far_sum = (float4)(0.0f);
    float near_area = 0.0f, area = 0.0f;
    for (int k = 0; k < 9; ++k) {
        const int bit = PIXEL_OF_3X3(k);
        if (!(sides.valid >> bit & 1u)) continue;
        const float3 c = not_negative(load_color(s.color, pixel_beside(s, x, y, k % 3 - 1, k / 3 - 1)));
        const float4 weighted = (is_pure(sides.near, bit) ? tent(k) : BESIDE_OTHER * tent(k)) * (float4)(c, 1.0f);
        const bool is_near = sides.near >> bit & 1u;
        near_sum += is_near ? weighted : (float4)(0.0f);
        far_sum += is_near ? (float4)(0.0f) : weighted;
        near_area += is_near ? tent(k) : 0.0f;
        area += tent(k);
    }
    const bool is_near = depth[y * s.width + x] < middle;
    const float3 own = not_negative(load_color(s.color, y * s.width + x));
    const float3 near_color = near_sum.xyz * divide(1.0f, near_sum.w), far_color = far_sum.xyz * divide(1.0f, far_sum.w);
    const float3 contrast = near_color - far_color, size = fmax(near_color, far_color);
    const float scale = divide(1.0f, 1e-4f + fmax(size.x, fmax(size.y, size.z)));
    const float3 relative = contrast * scale, offset = (own - far_color) * scale;
    const float squared = relative.x * relative.x + relative.y * relative.y + relative.z * relative.z;
    const float along = offset.x * relative.x + offset.y * relative.y + offset.z * relative.z;
    const float by_color = squared > 0.0f ? clamp(divide(along, squared), is_near ? 0.5f : 0.0f, is_near ? 1.0f : 0.5f) : 0.0f;
    const float trust = divide(squared, squared + TOO_ALIKE);
    const float coverage = trust * by_color + (1.0f - trust) * divide(near_area, area);
    return (float4)(is_near ? far_color : not_negative(own - coverage * contrast), coverage);
}

/* Which of LANES pixels, one pixel within the image, may have layers around that move apart. */
INLINE Ints layers_may_part(const Source s, const int src, __global const float *depth) {
    const Ints step = wide_is_step(depth, src, s.width);
    if (!ANY(step)) return step;
    const float none = INFINITY;
    Range x = {(Floats)(none), (Floats)(-none)}, y = x;
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1;
        __global const float *p = s.target_position + src + dy * s.width + dx;
        widen(&x, load_floats(0, p) - s.zoom.x * (float)dx);
        widen(&y, load_floats(0, p + s.width * s.height) - s.zoom.y * (float)dy);
    }
    return step & ((x.high - x.low > 0.99f * MOVES_APART) | (y.high - y.low > 0.99f * MOVES_APART));
}

/* Which layer each pixel belongs to; in `behind`, where it does, (colour of the far layer, coverage of the near one). */
WIDE __kernel void find_layers(const int source_width, const int source_height, const float2 zoom, __global const float *depth,
                               __global const uchar *links, __global const float *target_position, __global const half *color,
                               __global uchar *layer, __global half *behind) {
    const int src_x = get_global_id(0) * LANES, src_y = get_global_id(1);
    if (src_x >= source_width || src_y >= source_height) return;
    const int src = src_y * source_width + src_x, count = min(source_width - src_x, LANES);
    const Ints linked = to_ints(load_some_bytes(count, links + src));
    const Source s = {source_width, source_height, zoom, target_position, color};
    Ints edge = linked != (LINK_RIGHT | LINK_DOWN | LINK_LEFT | LINK_UP);
    if (ANY(edge) && src_x >= 1 && src_y >= 1 && src_x + LANES < source_width && src_y + 1 < source_height)
        edge &= layers_may_part(s, src, depth);
    if (!ANY(edge)) {
        store_some_bytes((Bytes)(NO_LAYER), count, layer + src);
        return;
    }
    int lane_edge[LANES];
    store_ints(edge, 0, lane_edge);
    for (int k = 0; k < count; ++k) {
        float middle;
        uchar found = NO_LAYER;
        if (lane_edge[k] && layers_part(s, src_x + k, src_y, depth, &middle)) {
            vstore_half4_rte(unmix(s, src_x + k, src_y, middle, depth), src + k, behind);
            found = depth[src + k] < middle ? NEAR : FAR;
        }
        layer[src + k] = found;
    }
}

/* ---- the new frame ---------------------------------------------------------------------------------------------- */

/* The new frame, whose every pixel shows what lies in the rendered frame where its motion points to. */
typedef struct {
    int width, height;
    __global const half *color;
    __global const float *depth;
    __global const float2 *motion;
    __global const uchar *filled_by, *mixed;
} Shown;

/* The rendered frame's layers. */
typedef struct {
    __global const uchar *layer;
    __global const half *behind;
} Layers;

inline bool is_warped(const uchar filled_by) { return filled_by == BY_WARP || filled_by == BY_CRACK_CLOSING; }

/* Whether fragment `src`, at (x, y), goes to depth z, and to `px`, by its place in the rendered image `px_source`, within `most` px. */
inline bool goes_along(const Source s, const int x, const int y, const float3 there, const float2 px, const float2 px_source,
                       const float z, const float most) {
    const float2 centre = pixel_centre(x, y);
    const float ex = there.x - px.x - s.zoom.x * (centre.x - px_source.x), ey = there.y - px.y - s.zoom.y * (centre.y - px_source.y);
    return there.z * SAME_LAYER <= z && z * SAME_LAYER <= there.z && fmax(fabs(ex), fabs(ey)) < most;
}

/* Whether colour of a nearer layer is mixed into what a pixel shows; (x0, y0): the first of the four pixels around its place. */
inline bool is_mixed_with_near(const Source s, const Layers l, const int x0, const int y0) {
    for (int k = 0; k < 4; ++k) {
        const int x = x0 + (k & 1), y = y0 + (k >> 1);
        if (inside(x, y, s.width, s.height) && l.layer[y * s.width + x] == FAR) return true;
    }
    return false;
}

/* Colour of a pixel without that of a nearer layer that was mixed into it. Gives whether it is another one. */
inline bool without_near(const Source s, const Layers l, const Shown f, const int dst_x, const int dst_y, float3 *rgb) {
    const int dst = dst_y * f.width + dst_x;
    *rgb = load_color(f.color, dst);
    if (!is_warped(f.filled_by[dst]) || f.mixed[dst]) return false;
    const float2 px = pixel_centre(dst_x, dst_y), px_source = px + f.motion[dst];
    const int x0 = (int)floor(px_source.x - 0.5f), y0 = (int)floor(px_source.y - 0.5f);
    if (!is_mixed_with_near(s, l, x0, y0)) return false;
    const float u = px_source.x - 0.5f - (float)x0, v = px_source.y - 0.5f - (float)y0;
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int k = 0; k < 4; ++k) {
        const int x = x0 + (k & 1), y = y0 + (k >> 1), src = y * s.width + x;
        if (!inside(x, y, s.width, s.height)) continue;
        const float3 there = position_of(s.target_position, src, s.width * s.height);
        if (!goes_along(s, x, y, there, px, px_source, f.depth[dst], ALIKE)) continue;
        const float weight = bilinear_weight(k, u, v);
        sum += weight * (l.layer[src] == FAR ? load_color(l.behind, src) : load_color(s.color, src));
        weight_sum += weight;
    }
    if (weight_sum > 0.05f) *rgb = mean_of(sum, weight_sum);
    return weight_sum > 0.05f;
}

/* Rows of 4x4 pixels, one after another. */
#define FOUR_ROWS(load, p, width) \
    ((float16)(load(0, p), load(0, (p) + (width)), load(0, (p) + 2 * (width)), load(0, (p) + 3 * (width))))
typedef struct { float16 r, g, b, a; } Taps;

inline Taps load_taps(__global const half *color, const int first, const int width) {
    const float16 row_0 = vload_half16(0, color + 4 * first), row_1 = vload_half16(0, color + 4 * (first + width));
    const float16 row_2 = vload_half16(0, color + 4 * (first + 2 * width)), row_3 = vload_half16(0, color + 4 * (first + 3 * width));
    const Taps taps = {(float16)(row_0.s048c, row_1.s048c, row_2.s048c, row_3.s048c),
                       (float16)(row_0.s159d, row_1.s159d, row_2.s159d, row_3.s159d),
                       (float16)(row_0.s26ae, row_1.s26ae, row_2.s26ae, row_3.s26ae),
                       (float16)(row_0.s37bf, row_1.s37bf, row_2.s37bf, row_3.s37bf)};
    return taps;
}

inline float16 finite(const float16 c) {  /* NaN and what is negative count as 0 */
    const float16 low = c > 0.0f ? c : (float16)(0.0f);
    return low < COLOR_MAX ? low : (float16)(COLOR_MAX);
}

inline float sum_of(const float16 v) {
    const float8 halves = v.lo + v.hi;
    const float4 quarters = halves.lo + halves.hi;
    return (quarters.x + quarters.y) + (quarters.z + quarters.w);
}

/* Mean of the taps, within what the inner ones of `known` hold. */
inline float mean_of_taps(const float16 taps, const float16 weights, const float scale, const int16 known) {
    const float16 lows = known ? taps : (float16)(INFINITY), highs = known ? taps : (float16)(0.0f);
    const float low = fmin(fmin(lows.s5, lows.s6), fmin(lows.s9, lows.sa)), high = fmax(fmax(highs.s5, highs.s6), fmax(highs.s9, highs.sa));
    return clamp(sum_of(weights * taps) * scale, low, high);
}

/* The near layer at `px_source` of the rendered frame: (its colour times its coverage, its coverage), cubic. False if it is not
   known: out of the image, or hidden by something else. */
inline bool near_layer(const Source s, const Layers l, const float2 px, const float2 px_source, const float z, float4 *near) {
    const int x = (int)floor(px_source.x - 0.5f) - 1, y = (int)floor(px_source.y - 0.5f) - 1;
    if (x < 0 || y < 0 || x + 4 > s.width || y + 4 > s.height) return false;
    const int first = y * s.width + x, plane = s.width * s.height;
    const float4 columns = (float4)(0.5f, 1.5f, 2.5f, 3.5f);
    const float4 from_x = ((float)x - px_source.x) + columns, from_y = ((float)y - px_source.y) + columns;
    __global const float *p = s.target_position + first;
    const float16 to_z = FOUR_ROWS(vload4, p + 2 * plane, s.width);
    const float16 ex = fabs(FOUR_ROWS(vload4, p, s.width) - px.x - s.zoom.x * from_x.s0123012301230123);
    const float16 ey = fabs(FOUR_ROWS(vload4, p + plane, s.width) - px.y - s.zoom.y * from_y.s0000111122223333);
    const int16 along = (to_z * SAME_LAYER <= z) & (z * SAME_LAYER <= to_z) & (ex < ALONG) & (ey < ALONG);
    const int16 known = along | !(to_z > 0.0f) | (to_z >= z);
    const float4 wx = cubic_weights(-from_x.y), wy = cubic_weights(-from_y.y);
    const float16 weights = known ? wx.s0123012301230123 * wy.s0000111122223333 : (float16)(0.0f);
    const float weight_sum = sum_of(weights);
    if (!(weight_sum > 0.5f) || !(known.s5 | known.s6 | known.s9 | known.sa)) return false;

    __global const uchar *layers = l.layer + first;
    const int16 layer = convert_int16((uchar16)(vload4(0, layers), vload4(0, layers + s.width), vload4(0, layers + 2 * s.width),
                                                vload4(0, layers + 3 * s.width)));
    const Taps shown = load_taps(s.color, first, s.width), behind = load_taps(l.behind, first, s.width);
    const int16 covered = along & (layer != NEAR), shared = (along & (layer == NEAR)) | (!along & (layer == FAR));
    const int16 seen_behind = along & (layer == FAR);
    const float16 share = shared ? behind.a : (float16)(0.0f), none = (float16)(0.0f);
    const float16 rest = 1.0f - share;
#define OF_NEAR_LAYER(c) (covered ? (seen_behind ? finite(behind.c) : finite(shown.c)) : shared ? finite(finite(shown.c) - rest * finite(behind.c)) : none)
    const float scale = divide(1.0f, weight_sum);
    const float coverage = mean_of_taps(covered ? (float16)(1.0f) : share, weights, scale, known);
    *near = (float4)(mean_of_taps(OF_NEAR_LAYER(r), weights, scale, known), mean_of_taps(OF_NEAR_LAYER(g), weights, scale, known),
                     mean_of_taps(OF_NEAR_LAYER(b), weights, scale, known), coverage);
    return true;
}

/* The two layers around a pixel of the new frame, on both sides of depth `middle`: where they lie in the rendered image,
   continued to this pixel's centre, how deep the near one is, and what the far one shows. */
typedef struct {
    float2 near_px, far_px;
    float near_z;
    float3 far_color;
} Pair;

/* Of the pixel itself for the layer that it shows; else the mean of its neighbours'. False if there are not two. */
inline bool find_pair(const Source s, const Layers l, const Shown f, const int dst_x, const int dst_y, Pair *pair) {
    const int dst = dst_y * f.width + dst_x;
    float nearest = INFINITY, farthest = 0.0f;
    for (int k = 0; k < 9; ++k) {
        const int x = dst_x + k % 3 - 1, y = dst_y + k / 3 - 1;
        if (!inside(x, y, f.width, f.height) || f.filled_by[y * f.width + x] == BY_NOTHING) continue;
        nearest = fmin(nearest, f.depth[y * f.width + x]);
        farthest = fmax(farthest, f.depth[y * f.width + x]);
    }
    if (f.filled_by[dst] == BY_NOTHING || !is_step(nearest, farthest)) return false;
    const float middle = between(nearest, farthest);
    const bool own_near = f.depth[dst] < middle, near_is_own = own_near && is_warped(f.filled_by[dst]);
    const float2 back = (float2)(divide(1.0f, s.zoom.x), divide(1.0f, s.zoom.y));
    float3 near_sum = (float3)(0.0f), far_color = (float3)(0.0f);
    float2 far_sum = (float2)(0.0f);
    float near_weight = 0.0f, far_weight = 0.0f;
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1, beside = dst + dy * f.width + dx;
        if (!inside(dst_x + dx, dst_y + dy, f.width, f.height) || f.filled_by[beside] == BY_NOTHING) continue;
        const bool is_near = f.depth[beside] < middle;
        if (is_near ? near_is_own != (k == 4) || !is_warped(f.filled_by[beside]) : own_near == (k == 4)) continue;
        const float2 px = pixel_centre(dst_x + dx, dst_y + dy) + f.motion[beside] - back * (float2)((float)dx, (float)dy);
        if (is_near) {
            near_sum += tent(k) * (float3)(px, f.depth[beside]);
            near_weight += tent(k);
        } else {
            float3 rgb;
            without_near(s, l, f, dst_x + dx, dst_y + dy, &rgb);
            far_sum += tent(k) * px;
            far_color += tent(k) * rgb;
            far_weight += tent(k);
        }
    }
    if (near_weight == 0.0f || far_weight == 0.0f) return false;
    const float3 near = mean_of(near_sum, near_weight);
    pair->near_px = near.xy;
    pair->near_z = near.z;
    pair->far_px = (float2)(divide(far_sum.x, far_weight), divide(far_sum.y, far_weight));
    pair->far_color = mean_of(far_color, far_weight);
    const float2 apart = fabs(pair->near_px - pair->far_px);
    return fmax(apart.x, apart.y) > MOVES_APART;
}

/* Value of `coverage` of a pixel, 0 if it stays as it is; else stores its colour. */
inline uchar soften_pixel(const Source s, const Layers l, const Shown f, const int dst_x, const int dst_y, __global half *softened) {
    const int dst = dst_y * f.width + dst_x;
    Pair pair;
    float4 near;
    float3 rgb;
    if (find_pair(s, l, f, dst_x, dst_y, &pair)
        && near_layer(s, l, pixel_centre(dst_x, dst_y), pair.near_px, pair.near_z, &near)) {
        store_color(near.xyz + (1.0f - near.w) * pair.far_color, softened, dst);
        return (uchar)(1.0f + 254.0f * near.w + 0.5f);
    }
    if (!without_near(s, l, f, dst_x, dst_y, &rgb)) return 0;
    store_color(rgb, softened, dst);
    return 1;
}

/* Whether a strip of pixels and all around it are warped backward: they show one surface. */
inline bool is_smooth(const int dst_x, const int dst_y, const int width, const int height, __global const uchar *block_class) {
    const int x0 = max(dst_x - 1, 0) / BLOCK_WIDTH, x1 = min(dst_x + LANES, width - 1) / BLOCK_WIDTH;
    const int y0 = max(dst_y - 1, 0) / BLOCK_HEIGHT, y1 = min(dst_y + 1, height - 1) / BLOCK_HEIGHT;
    for (int y = y0; y <= y1; ++y)
        for (int x = x0; x <= x1; ++x)
            if (block_class[y * block_columns(width) + x] != BACKWARD) return false;
    return true;
}

/* Which of LANES pixels, one pixel within the image, may lie between layers that move apart. */
INLINE Ints may_have_pair(const Source s, const Shown f, const int dst) {
    const Ints step = wide_is_step(f.depth, dst, f.width);
    if (!ANY(step)) return step;
    const float none = INFINITY, back_x = 1.0f - 1.0f / s.zoom.x, back_y = 1.0f - 1.0f / s.zoom.y;
    Range x = {(Floats)(none), (Floats)(-none)}, y = x;
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1;
        Floats motion_y;
        const Floats motion_x = load_xy(f.motion + dst + dy * f.width + dx, &motion_y);
        widen(&x, motion_x + back_x * (float)dx);
        widen(&y, motion_y + back_y * (float)dy);
    }
    return step & ((x.high - x.low > 0.99f * MOVES_APART) | (y.high - y.low > 0.99f * MOVES_APART));
}

/* Which of LANES pixels may show pixels of a far layer. */
INLINE Ints may_be_mixed(const Source s, const Layers l, const Shown f, const int dst_x, const int dst_y) {
    Floats motion_y;
    const Floats motion_x = load_xy(f.motion + dst_y * f.width + dst_x, &motion_y);
    const Floats px_x = row_centres(dst_x) + motion_x - 0.5f, px_y = (float)dst_y + 0.5f + motion_y - 0.5f;
    const Ints in_image = (px_x >= 0.0f) & (px_y >= 0.0f) & (px_x < (float)(s.width - 1)) & (px_y < (float)(s.height - 1));
    if (!ALL(in_image)) return (Ints)(-1);
    const Ints taps = to_ints(px_y) * s.width + to_ints(px_x);
    const int first = FIRST_LANE(taps);
    const bool is_run = ALL(taps == first + LANE_NUMBERS);
    Ints mixed = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        __global const uchar *p = l.layer + (k >> 1) * s.width + (k & 1);
        mixed |= to_ints(is_run ? load_bytes(0, p + first) : gather_bytes(p, taps)) == FAR;
    }
    return mixed;
}

/* The new colours, and `coverage`: 0 where a pixel stays as it is, else 1 + 254 times the nearer layer's share. */
WIDE __kernel void soften(const int source_width, const int source_height, const int target_width, const int target_height,
                          const float2 zoom, __global const uchar *block_class,
                          __global const float *target_position, __global const half *source_color, __global const uchar *layer,
                          __global const half *behind, __global const half *color, __global const float *depth,
                          __global const float2 *motion, __global const uchar *filled_by, __global const uchar *mixed,
                          __global uchar *coverage, __global half *softened) {
    const int dst_x = get_global_id(0) * LANES, dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x, count = min(target_width - dst_x, LANES);
    const Source s = {source_width, source_height, zoom, target_position, source_color};
    const Layers l = {layer, behind};
    const Shown f = {target_width, target_height, color, depth, motion, filled_by, mixed};
    Ints soft = (Ints)(0);
    if (!is_smooth(dst_x, dst_y, target_width, target_height, block_class)) {
        soft = (Ints)(-1);
        if (dst_x >= 1 && dst_y >= 1 && dst_x + LANES < target_width && dst_y + 1 < target_height)
            soft = may_have_pair(s, f, dst) | may_be_mixed(s, l, f, dst_x, dst_y);
    }
    if (!ANY(soft)) {
        store_some_bytes((Bytes)(0), count, coverage + dst);
        return;
    }
    int lane_soft[LANES];
    store_ints(soft, 0, lane_soft);
    for (int k = 0; k < count; ++k)
        coverage[dst + k] = lane_soft[k] ? soften_pixel(s, l, f, dst_x + k, dst_y, softened) : (uchar)0;
}

/* The new colours go to the frame, RUN pixels per work-item. */
SCAN __kernel void apply_softened(const int target_width, const int target_height, __global const uchar *coverage,
                                  __global const half *softened, __global half *color) {
    const int first_x = get_global_id(0) * RUN, dst_y = get_global_id(1);
    if (first_x >= target_width || dst_y >= target_height) return;
    const int first = dst_y * target_width + first_x;
    if (first_x + RUN <= target_width && run_is_zero(coverage + first)) return;
    for (int dst = first; dst < dst_y * target_width + min(first_x + RUN, target_width); ++dst)
        if (coverage[dst]) vstore_half4_rte(vload_half4(dst, softened), dst, color);
}
