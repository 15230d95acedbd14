/* Silhouettes: edges of what moves over something else, as soft as the rendered frame has them.
   A rendered frame is antialiased: a pixel at a silhouette holds a share of the nearer surface, its coverage, and what it covers.
   Where both move apart, that share is estimated and carried along with the nearer surface, over what the new frame shows behind.
   Only pixels at steps of depth whose two sides move apart are looked at; LANES of others are skipped at once. */

#include "common.h"
#include "wide.h"
#include "flow.h"
#include "blocks.h"
#include "rgb9e5.h"

#define STEP 0.05f           /* relative step of inverse depth between two layers */
#define MOVES_APART 0.5f     /* px: layers that deviate less are resampled together */
#define SAME_LAYER 0.85f     /* least ratio of the depths of fragments of one layer */
#define ALONG 3.0f           /* px by which fragments of a layer may deviate from its motion ... */
#define ALIKE 1.0f           /* ... and those from which one colour is interpolated */
#define AT_EDGE 0.05f        /* weight of colours at edges, which may be mixed, too */
#define TOO_ALIKE 0.03125f   /* squared relative contrast of two layers below which colours tell the coverage in part only */

#define SHARES 255.0f         /* of a pixel, stored as a byte */
#define SHARPER 1.25f        /* steepness of coverage, which interpolation has smoothed */

/* Values of `layer`: the pixel belongs to one of two layers around it that move apart. */
#define NO_LAYER 0
#define FAR 1
#define NEAR 2

#define ALL_LINKS 15
#define ANYWHERE 100000000.0f /* px: fragments that go nowhere are told to go farther away */
#define MARKED 3             /* px around a layer's fragments within which silhouettes are looked for; less than a block's sides */

/* Weight of pixel k of 3x3 in the middle one's coverage: a pixel's area, filtered over two. */
inline float tent(const int k) { return k == 4 ? 4.0f : (k & 1) ? 2.0f : 1.0f; }

/* Depth between that of two layers, halfway in inverse depth. */
inline float between(const float nearest, const float farthest) {
    return isinf(farthest) ? 2.0f * nearest : 2.0f * nearest * divide(farthest, nearest + farthest);
}

inline bool is_step(const float nearest, const float farthest) { return nearest < (1.0f - STEP) * farthest; }

inline float3 not_negative(const float3 c) { return fmax(c, 0.0f); }

/* ---- layers of the rendered frame ------------------------------------------------------------------------------ */

/* The rendered frame, and where its fragments go. */
typedef struct {
    int width, height;
    float2 zoom;
    __global const float *target_position;
    __global const half *color;
} Source;

/* LANES pixels of an image from (x, y) on. `inner`: those around lie inside, too; else they are clamped to it. */
typedef struct { int x, y, width, height; bool inner; } Strip;

INLINE Floats beside(const Strip p, __global const float *plane, const int dx, const int dy) {
    if (p.inner) return load_floats(0, plane + (p.y + dy) * p.width + p.x + dx);
    const Ints x = clamp(p.x + dx + LANE_NUMBERS, (Ints)(0), (Ints)(p.width - 1));
    return gather_floats(plane + clamp(p.y + dy, 0, p.height - 1) * p.width, x);
}

/* Depths of the 3x3 pixels around each of them, and what lies halfway between the sides if these are apart. */
typedef struct { Floats z[9], middle; } Depths;

/* Which of them lie at a step of depth. */
INLINE Ints at_step(const Strip p, __global const float *depth, Depths *d) {
    Floats nearest = INFINITY, farthest = 0.0f;
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const Floats z = beside(p, depth, k % 3 - 1, k / 3 - 1);
        nearest = (z > 0.0f) & (z < nearest) ? z : nearest;
        farthest = z > farthest ? z : farthest;
        d->z[k] = z;
    }
    const Ints step = nearest < (1.0f - STEP) * farthest;
    if (ANY(step)) d->middle = 2.0f * nearest * (isinf(farthest) ? (Floats)(1.0f) : wide_divide(farthest, nearest + farthest));
    return step;
}

/* Which of them have layers around, on both sides of d->middle, that move apart. */
INLINE Ints layers_part(const Strip p, const Source s, __global const float *depth, Depths *d) {
    const Ints step = at_step(p, depth, d);
    if (!ANY(step)) return step;
    __global const float *to_x = s.target_position, *to_y = to_x + p.width * p.height;
    const Floats x = beside(p, to_x, 0, 0), y = beside(p, to_y, 0, 0);
    const Ints is_near = d->z[4] < d->middle;
    Ints part = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1;
        if (k == 4 || (!p.inner && (p.y + dy < 0 || p.y + dy >= p.height))) continue;
        const Floats ex = fabs(beside(p, to_x, dx, dy) - x - s.zoom.x * (float)dx);
        const Floats ey = fabs(beside(p, to_y, dx, dy) - y - s.zoom.y * (float)dy);
        Ints other = ((d->z[k] < d->middle) != is_near) & (d->z[k] > 0.0f) & (ex < ANYWHERE);
        if (!p.inner) other &= (p.x + dx + LANE_NUMBERS >= 0) & (p.x + dx + LANE_NUMBERS < p.width);
        part |= other & ((ex > MOVES_APART) | (ey > MOVES_APART));
    }
    return step & part & (d->z[4] > 0.0f);
}

/* The nearer layer's share of pixel (x, y), and the colour of what it covers: where the pixel's colour lies between the mean
   colours of both layers around, as far as these differ; else from the pixels that each layer has. */
inline float4 unmix(const Source s, const int x, const int y, const float middle, __global const float *depth,
                    __global const uchar *links) {
    const int src = y * s.width + x;
    float4 near_sum = (float4)(0.0f), far_sum = (float4)(0.0f);
    float near_area = 0.0f, area = 0.0f;
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1, there = src + dy * s.width + dx;
        if (!inside(x + dx, y + dy, s.width, s.height) || INVALID_DEPTH(depth[there])) continue;
        const float3 c = not_negative(load_color(s.color, there));
        const float4 weighted = (links[there] == ALL_LINKS ? tent(k) : AT_EDGE * tent(k)) * (float4)(c, 1.0f);
        const bool is_near = depth[there] < middle;
        near_sum += is_near ? weighted : (float4)(0.0f);
        far_sum += is_near ? (float4)(0.0f) : weighted;
        near_area += is_near ? tent(k) : 0.0f;
        area += tent(k);
    }
    const bool is_near = depth[src] < middle;
    const float3 own = not_negative(load_color(s.color, src));
    const float3 near_color = near_sum.xyz * divide(1.0f, near_sum.w), far_color = far_sum.xyz * divide(1.0f, far_sum.w);
    const float3 contrast = near_color - far_color, size = fmax(near_color, far_color);
    const float scale = divide(1.0f, 1e-4f + fmax(size.x, fmax(size.y, size.z)));
    const float3 relative = contrast * scale, offset = (own - far_color) * scale;
    const float squared = relative.x * relative.x + relative.y * relative.y + relative.z * relative.z;
    const float along = offset.x * relative.x + offset.y * relative.y + offset.z * relative.z;
    const float by_color = squared > 0.0f ? clamp(divide(along, squared), is_near ? 0.5f : 0.0f, is_near ? 1.0f : 0.5f) : 0.0f;
    const float trust = fmin(squared * (1.0f / TOO_ALIKE), 1.0f);
    const float coverage = trust * by_color + (1.0f - trust) * divide(near_area, area);
    return (float4)(is_near ? far_color : not_negative(own - coverage * contrast), coverage);
}

/* Marks the blocks around the pixel where a fragment goes. */
inline void mark_around(const float2 px, const int width, const int height, __global uchar *marked) {
    if (!(px.x > -(float)MARKED && px.y > -(float)MARKED && px.x < (float)(width + MARKED) && px.y < (float)(height + MARKED))) return;
    for (int k = 0; k < 4; ++k) {
        const int x = (int)px.x + ((k & 1) ? MARKED : -MARKED), y = (int)px.y + ((k >> 1) ? MARKED : -MARKED);
        marked[block_of(clamp(x, 0, width - 1), clamp(y, 0, height - 1), width)] = 1;
    }
}

/* Which layer each pixel belongs to; where it does, the colour of the far layer, `behind`, and the near one's `share` of the pixel.
   Marks the target blocks where they go; they come unmarked. */
WIDE __kernel void find_layers(const int source_width, const int source_height, const int target_width, const int target_height,
                               const float2 zoom, __global const float *depth, __global const uchar *links,
                               __global const float *target_position, __global const half *color, __global uchar *layer,
                               __global uint *behind, __global uchar *share, __global uchar *marked) {
    const int src_x = get_global_id(0) * LANES, src_y = get_global_id(1);
    if (src_x >= source_width || src_y >= source_height) return;
    const int src = src_y * source_width + src_x, count = min(source_width - src_x, LANES);
    const Source s = {source_width, source_height, zoom, target_position, color};
    Strip p = {src_x, src_y, source_width, source_height, false};
    Depths d;
    Ints part = to_ints(load_some_bytes(count, links + src)) != ALL_LINKS;
    if (ANY(part)) {
        if (src_x >= 1 && src_y >= 1 && src_x + LANES < source_width && src_y + 1 < source_height) {
            p.inner = true;
            part &= layers_part(p, s, depth, &d);
        } else {
            part &= layers_part(p, s, depth, &d);
        }
    }
    if (!ANY(part)) {
        store_some_bytes((Bytes)(NO_LAYER), count, layer + src);
        return;
    }
    const Ints side = d.z[4] < d.middle ? (Ints)(NEAR) : (Ints)(FAR);
    store_some_bytes(to_bytes(part ? side : (Ints)(NO_LAYER)), count, layer + src);
    int lane_part[LANES];
    float lane_middle[LANES];
    store_ints(part, 0, lane_part);
    store_floats(d.middle, 0, lane_middle);
    for (int k = 0; k < count; ++k) {
        if (!lane_part[k]) continue;
        const float4 unmixed = unmix(s, src_x + k, src_y, lane_middle[k], depth, links);
        behind[src + k] = pack_color(unmixed.xyz);
        share[src + k] = (uchar)(SHARES * unmixed.w + 0.5f);
        mark_around(position_of(target_position, src + k, source_width * source_height).xy, target_width, target_height, marked);
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
    __global const uint *behind;
    __global const uchar *share;
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
        sum += weight * (l.layer[src] == FAR ? unpack_color(l.behind[src]) : load_color(s.color, src));
        weight_sum += weight;
    }
    if (weight_sum > 0.05f) *rgb = mean_of(sum, weight_sum);
    return weight_sum > 0.05f;
}

/* The near layer at `px_source` of the rendered frame, bilinear and sharpened: (its colour times its coverage, its coverage). False if it is not
   known: out of the image, or hidden by something else. */
inline bool near_layer(const Source s, const Layers l, const float2 px, const float2 px_source, const float z, float4 *near) {
    const int x0 = (int)floor(px_source.x - 0.5f), y0 = (int)floor(px_source.y - 0.5f);
    const float u = px_source.x - 0.5f - (float)x0, v = px_source.y - 0.5f - (float)y0;
    float4 sum = (float4)(0.0f);
    float weight_sum = 0.0f;
    for (int k = 0; k < 4; ++k) {
        const int x = x0 + (k & 1), y = y0 + (k >> 1), src = y * s.width + x;
        if (!inside(x, y, s.width, s.height)) continue;
        const float3 there = position_of(s.target_position, src, s.width * s.height);
        const bool along = goes_along(s, x, y, there, px, px_source, z, ALONG);
        if (!along && there.z > 0.0f && there.z < z) continue;
        const uchar layer = l.layer[src];
        const float weight = bilinear_weight(k, u, v);
        weight_sum += weight;
        if (along && layer != NEAR) {
            sum += weight * (float4)(layer == FAR ? unpack_color(l.behind[src]) : not_negative(load_color(s.color, src)), 1.0f);
        } else if (along || layer == FAR) {
            const float share = (float)l.share[src] * (1.0f / SHARES);
            const float3 own = not_negative(load_color(s.color, src));
            sum += weight * (float4)(not_negative(own - (1.0f - share) * unpack_color(l.behind[src])), share);
        }
    }
    if (!(weight_sum > 0.5f)) return false;
    const float share = divide(sum.w, weight_sum), coverage = clamp(SHARPER * (share - 0.5f) + 0.5f, 0.0f, 1.0f);
    *near = (float4)(sum.xyz * (coverage > 0.0f ? divide(coverage, sum.w) : 0.0f), coverage);
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
    const float2 back = (float2)(divide(1.0f, s.zoom.x), divide(1.0f, s.zoom.y));
    float3 near_sum = (float3)(0.0f), far_color = (float3)(0.0f);
    float2 far_sum = (float2)(0.0f);
    float near_weight = 0.0f, far_weight = 0.0f;
    bool near_known = false, far_known = false;
    for (int i = 0; i < 9; ++i) {  /* itself, those beside it, and at its corners where there are none */
        if (i == 1 || i == 5) {
            near_known = near_weight > 0.0f;
            far_known = far_weight > 0.0f;
        }
        const int k = (int)(0x862075314L >> 4 * i) & 15, dx = k % 3 - 1, dy = k / 3 - 1, there = dst + dy * f.width + dx;
        if (!inside(dst_x + dx, dst_y + dy, f.width, f.height) || f.filled_by[there] == BY_NOTHING) continue;
        const bool is_near = f.depth[there] < middle;
        if (is_near ? near_known || !is_warped(f.filled_by[there]) : far_known) continue;
        const float2 px = pixel_centre(dst_x + dx, dst_y + dy) + f.motion[there] - back * (float2)((float)dx, (float)dy);
        if (is_near) {
            near_sum += (float3)(px, f.depth[there]);
            near_weight += 1.0f;
        } else {
            float3 rgb;
            without_near(s, l, f, dst_x + dx, dst_y + dy, &rgb);
            far_sum += px;
            far_color += rgb;
            far_weight += 1.0f;
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
inline uchar soften_pixel(const Source s, const Layers l, const Shown f, const int dst_x, const int dst_y, __global uint *softened) {
    const int dst = dst_y * f.width + dst_x;
    Pair pair;
    float4 near;
    float3 rgb;
    if (find_pair(s, l, f, dst_x, dst_y, &pair)
        && near_layer(s, l, pixel_centre(dst_x, dst_y), pair.near_px, pair.near_z, &near)) {
        softened[dst] = pack_color(near.xyz + (1.0f - near.w) * pair.far_color);
        return (uchar)(1.0f + 254.0f * near.w + 0.5f);
    }
    if (!without_near(s, l, f, dst_x, dst_y, &rgb)) return 0;
    softened[dst] = pack_color(rgb);
    return 1;
}

/* Which of LANES pixels may lie between layers that move apart. */
INLINE Ints may_have_pair(const Strip p, const Source s, const Shown f) {
    Depths d;
    const Ints step = at_step(p, f.depth, &d);
    if (!p.inner || !ANY(step)) return step;
    const float none = INFINITY, back_x = 1.0f - 1.0f / s.zoom.x, back_y = 1.0f - 1.0f / s.zoom.y;
    Floats low_x = none, high_x = -none, low_y = none, high_y = -none;
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1;
        Floats y;
        const Floats x = load_xy(f.motion + (p.y + dy) * p.width + p.x + dx, &y) + back_x * (float)dx;
        y += back_y * (float)dy;
        low_x = x < low_x ? x : low_x;
        high_x = x > high_x ? x : high_x;
        low_y = y < low_y ? y : low_y;
        high_y = y > high_y ? y : high_y;
    }
    return step & ((high_x - low_x > 0.99f * MOVES_APART) | (high_y - low_y > 0.99f * MOVES_APART));
}

/* Which of LANES pixels may show pixels of a far layer. */
INLINE Ints may_be_mixed(const Strip p, const Source s, const Layers l, const Shown f) {
    if (!p.inner) return (Ints)(-1);
    Floats motion_y;
    const Floats motion_x = load_xy(f.motion + p.y * p.width + p.x, &motion_y);
    const Floats px_x = row_centres(p.x) + motion_x - 0.5f, px_y = (float)p.y + 0.5f + motion_y - 0.5f;
    const Ints in_image = (px_x >= 0.0f) & (px_y >= 0.0f) & (px_x < (float)(s.width - 1)) & (px_y < (float)(s.height - 1));
    if (!ALL(in_image)) return (Ints)(-1);
    const Ints taps = to_ints(px_y) * s.width + to_ints(px_x);
    Ints mixed = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 4; ++k) mixed |= to_ints(gather_bytes(l.layer + (k >> 1) * s.width + (k & 1), taps)) == FAR;
    return mixed;
}

/* The new colours, and `coverage`: 0 where a pixel stays as it is, else 1 + 254 times the nearer layer's share. Nothing in blocks
   that are not marked. */
WIDE __kernel void soften(const int source_width, const int source_height, const int target_width, const int target_height,
                          const float2 zoom, __global const uchar *marked,
                          __global const float *target_position, __global const half *source_color, __global const uchar *layer,
                          __global const uint *behind, __global const uchar *share, __global const half *color, __global const float *depth,
                          __global const float2 *motion, __global const uchar *filled_by, __global const uchar *mixed,
                          __global uchar *coverage, __global uint *softened) {
    const int dst_x = get_global_id(0) * LANES, dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height || !marked[block_of(dst_x, dst_y, target_width)]) return;
    const int dst = dst_y * target_width + dst_x, count = min(target_width - dst_x, LANES);
    const Source s = {source_width, source_height, zoom, target_position, source_color};
    const Layers l = {layer, behind, share};
    const Shown f = {target_width, target_height, color, depth, motion, filled_by, mixed};
    Strip p = {dst_x, dst_y, target_width, target_height, false};
    Ints soft = (Ints)(0);
    if (dst_x >= 1 && dst_y >= 1 && dst_x + LANES < target_width && dst_y + 1 < target_height) {
        p.inner = true;
        soft = may_have_pair(p, s, f) | may_be_mixed(p, s, l, f);
    } else {
        soft = may_have_pair(p, s, f) | may_be_mixed(p, s, l, f);
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
SCAN __kernel void apply_softened(const int target_width, const int target_height, __global const uchar *marked,
                                  __global const uchar *coverage, __global const uint *softened, __global half *color) {
    const int first_x = get_global_id(0) * RUN, dst_y = get_global_id(1);
    if (first_x >= target_width || dst_y >= target_height) return;
    const int end_x = min(first_x + RUN, target_width);
    for (int block_x = first_x; block_x < end_x; block_x += BLOCK_WIDTH) {
        if (!marked[block_of(block_x, dst_y, target_width)]) continue;
        for (int dst_x = block_x; dst_x < min(block_x + BLOCK_WIDTH, end_x); ++dst_x) {
            const int dst = dst_y * target_width + dst_x;
            if (coverage[dst]) store_color(unpack_color(softened[dst]), color, dst);
        }
    }
}
