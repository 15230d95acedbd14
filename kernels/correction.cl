/* What surrounds the shading correction network (paper: 'Shading Correction Network'): its input at half resolution, and the
   frame that its output makes of the extrapolated one. */

#include "frame.h"
#include "warped_previous.h"
#include "mu_law.h"

#define BIN_BITS 16       /* dropped from a depth: bins are 1/128 of a power of two wide */
#define BINS 32768
#define COUNTED_ROWS 8    /* depth_histogram counts every eighth row */
#define STRIP 128         /* rows per work-item of depth_histogram: equal bins one after another cost one atomic */
#define SCANNERS 64       /* work-items of find_median */
#define MAX_INVERSE_DEPTH 8.0f
#define LEAST_MASK 0.03125f  /* a smaller focus mask is 0 */

/* How often each bin of finite depth occurs in some of the rows. */
WIDE __kernel void depth_histogram(const Frame frame, __global const float *depth, __global uint *histogram) {
    const int target_width = frame.target_width, target_height = frame.target_height;
    const int dst_x = get_global_id(0) * LANES, first = get_global_id(1) * STRIP, count = target_width - dst_x;
    if (count <= 0) return;
    int bin = -1;
    uint run = 0;
    for (int dst_y = first; dst_y < min(first + STRIP, target_height); dst_y += COUNTED_ROWS) {
        const Floats z = load_some_floats(count, depth + dst_y * target_width + dst_x);
        const Ints counts = (LANE_NUMBERS < count) & (z > 0.0f) & !isinf(z);
        const Ints bins = counts ? floats_as_ints(z) >> BIN_BITS : (Ints)(-1);
        if (ALL(bins == bin)) {
            if (bin >= 0) run += LANES;
            continue;
        }
        int lane_bins[LANES];
        store_ints(bins, 0, lane_bins);
        for (int k = 0; k < LANES; ++k) {
            if (lane_bins[k] < 0) continue;
            if (lane_bins[k] != bin) {
                if (run) atomic_add(histogram + bin, run);
                bin = lane_bins[k];
                run = 0;
            }
            ++run;
        }
    }
    if (run) atomic_add(histogram + bin, run);
}

/* The middle of the bin in which half of the depths is reached; 1 if there are none. One work-group. */
__kernel __attribute__((reqd_work_group_size(SCANNERS, 1, 1)))
void find_median(__global const uint *histogram, __global float *median_depth) {
    const uint part = get_local_id(0);
    __local uint sums[SCANNERS];
    uint sum = 0;
    for (uint bin = part * (BINS / SCANNERS); bin < (part + 1) * (BINS / SCANNERS); ++bin) sum += histogram[bin];
    sums[part] = sum;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (part) return;
    uint total = 0, below = 0, bin = 0;
    for (int k = 0; k < SCANNERS; ++k) total += sums[k];
    const uint half_way = (total + 1) / 2;
    for (; bin < SCANNERS - 1 && below + sums[bin] < half_way; ++bin) below += sums[bin];
    for (bin *= BINS / SCANNERS; bin < BINS - 1 && below + histogram[bin] < half_way; ++bin) below += histogram[bin];
    *median_depth = total ? as_float((bin << BIN_BITS) | (1u << (BIN_BITS - 1))) : 1.0f;
}

/* Of a strip of two rows: products of lifted colours, which stay below 1e28. */
inline Strip lifted_rows(const Strip top, const Strip bottom, const float4 law) {
    Strip product;
#pragma unroll
    for (int part = 0; part < PARTS; ++part)
        product.part[part] = LIFTED(Texels, top.part[part], law) * LIFTED(Texels, bottom.part[part], law);
    return product;
}

#if LANES == 8
#define CHANNEL(a, b, c) ((float8)((a).part[0].s##c, (a).part[1].s##c, (b).part[0].s##c, (b).part[1].s##c))
#define LEFT(a, b) {CHANNEL(a, b, 08), CHANNEL(a, b, 19), CHANNEL(a, b, 2a)}
#define RIGHT(a, b) {CHANNEL(a, b, 4c), CHANNEL(a, b, 5d), CHANNEL(a, b, 6e)}
#else
#define LEFT(a, b) {(a).part[0].x, (a).part[0].y, (a).part[0].z}
#define RIGHT(a, b) {(b).part[0].x, (b).part[0].y, (b).part[0].z}
#endif

/* Means over 2x2 pixels, encoded, of what lifted_rows made of two strips side by side: three planes of the network's input. */
inline void store_colors(const Strip a, const Strip b, const float4 law, const int plane_size, __global float *planes) {
    const WideRgb left = LEFT(a, b), right = RIGHT(a, b);
    const float scale = 0.25f * law.y;
    store_floats(scale * log_of_product(left.r, right.r), 0, planes);
    store_floats(scale * log_of_product(left.g, right.g), 0, planes + plane_size);
    store_floats(scale * log_of_product(left.b, right.b), 0, planes + 2 * plane_size);
}

/* Planes of the network's input: means over 2x2 pixels, the image's border repeated. */
WIDE __kernel void network_input(const Frame frame, __global const half *color, __global const float *depth,
                                 __global const float2 *out_motion, __global const uchar *is_dynamic,
                                 __global const uchar *disoccluded, __global const float2 *motion,
                                 __global const half *color_prev, __global const float *depth_prev,
                                 __global const float *median_depth, __global float *planes) {
    const int target_width = frame.target_width, target_height = frame.target_height;
    const int source_width = frame.source_width, source_height = frame.source_height;
    const int network_width = frame.network_width, network_height = frame.network_height;
    const float4 law = frame.color_law;
    const Reprojection to_previous = frame.target_to_previous;
    const int net_x = get_global_id(0) * LANES, net_y = get_global_id(1);
    if (net_x >= network_width || net_y >= network_height) return;
    const Frames frames = {1, target_width, source_width, source_height, color, color_prev, depth, depth_prev,
                           out_motion, motion, is_dynamic, disoccluded, to_previous};
    StripOfFrame strips[4];  /* left, right; of two rows */
    Strip colors[4], before[4];
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        const int x = min(2 * net_x + (k & 1) * LANES, target_width - 1), y = min(2 * net_y + (k >> 1), target_height - 1);
        strips[k] = strip_of_frame(&frames, x, y);
        colors[k] = load_strip(strips[k].count, color + 4 * strips[k].first);
        previous_of(&frames, strips + k, colors + k, before + k);
        before[k] = as_halfs(before[k]);
    }
    Floats inverse = 0.0f, mask = 0.0f;
#pragma unroll
    for (int row = 0; row < 2; ++row) {
        const StripOfFrame *a = strips + 2 * row, *b = a + 1;
        const Pairs near = *median_depth / (Pairs)(a->depth, b->depth);
        const Pairs nearness = near < MAX_INVERSE_DEPTH ? near : (Pairs)(MAX_INVERSE_DEPTH);
        const Pairs masks = (Pairs)(input_mask_of(a), input_mask_of(b));
        inverse += nearness.even + nearness.odd;
        mask += masks.even + masks.odd;
    }
    const int plane_size = network_width * network_height;
    __global float *out = planes + net_y * network_width + net_x;
    store_colors(lifted_rows(colors[0], colors[2], law), lifted_rows(colors[1], colors[3], law), law, plane_size, out);
    store_colors(lifted_rows(before[0], before[2], law), lifted_rows(before[1], before[3], law), law, plane_size, out + 3 * plane_size);
    store_floats(0.25f * inverse, 0, out + 6 * plane_size);
    store_floats(0.25f * mask, 0, out + 7 * plane_size);
}

/* The four taps, in an image at half resolution, of pixels from (x, y) on. `inner`: those to the left and to the right are
   in 8 pixels from `first` on, else `left` and `right`. */
typedef struct {
    int top, bottom, first;
    Ints left, right;
    Floats u;
    float v;
    bool inner;
} Taps;

inline Taps taps_of(const int x, const int y, const int width, const int height) {
    const Ints columns = x + LANE_NUMBERS, x0 = (columns - 1) >> 1;
    const int y0 = (y - 1) >> 1, first = (x >> 1) - 1;
    Taps t;
    t.top = max(y0, 0) * width;
    t.bottom = min(y0 + 1, height - 1) * width;
    t.first = first;
    t.left = max(x0, (Ints)(0));
    t.right = min(x0 + 1, (Ints)(width - 1));
    t.u = (columns & 1) == 1 ? (Floats)(0.25f) : (Floats)(0.75f);
    t.v = (y & 1) ? 0.25f : 0.75f;
    t.inner = first >= 0 && first + 8 <= width;
    return t;
}

/* Bilinear interpolation of a plane. */
INLINE Floats interpolate(__global const float *plane, const Taps *t) {
    Floats a, b, c, d;
#if LANES == 8
    if (t->inner) {
        const float8 top = vload8(0, plane + t->top + t->first), bottom = vload8(0, plane + t->bottom + t->first);
        a = top.s01122334;
        b = top.s12233445;
        c = bottom.s01122334;
        d = bottom.s12233445;
    } else
#endif
    {
        a = gather_floats(plane + t->top, t->left);
        b = gather_floats(plane + t->top, t->right);
        c = gather_floats(plane + t->bottom, t->left);
        d = gather_floats(plane + t->bottom, t->right);
    }
    const Floats u = t->u;
    const float v = t->v;
    return (1.0f - u) * (1.0f - v) * a + u * (1.0f - v) * b + (1.0f - u) * v * c + u * v * d;
}

/* Stores the lanes of a mixture that hold, and of the others the extrapolated colour's own bits. */
inline void store_where(const Ints holds, const WideRgb c, const int count, __global const half *color, __global half *out) {
    if (count >= LANES && ALL(holds)) {
        store_rgb_run(c, out);
        return;
    }
    if (count >= LANES && !ANY(holds)) {
        copy_rgb_run(color, out);
        return;
    }
    int lane_holds[LANES];
    float r[LANES], g[LANES], b[LANES];
    store_ints(holds, 0, lane_holds);
    store_floats(c.r, 0, r);
    store_floats(c.g, 0, g);
    store_floats(c.b, 0, b);
    for (int k = 0; k < min(count, LANES); ++k) {
        if (lane_holds[k]) {
            vstore_half4_rte((float4)(r[k], g[k], b[k], 0.0f), k, out);
        } else {
            ((__global uint2 *)out)[k] = ((__global const uint2 *)color)[k];
        }
    }
}

/* Bits of `asked`: whether the image is left as it is where the mask is 0, and whether `refined` is wanted. */
#define WITHIN_MASK 1
#define WITH_REFINED 2

/* refined: the network's image, the detail of the extrapolated one kept as it says; out_color: that within the focus mask,
   the extrapolated colour's own bits where the mask is 0. Output that is not finite counts as no mask. `refined` is made only
   for whoever asks for it: else a run of pixels without mask is a copy. */
WIDE __kernel void correct(const Frame frame, const int asked, __global const half *color,
                           __global const float *frames, __global const float *correction, __global half *refined,
                           __global half *focus_mask, __global half *out_color) {
    const bool within_mask = asked & WITHIN_MASK, with_refined = asked & WITH_REFINED;
    const int target_width = frame.target_width, target_height = frame.target_height;
    const int network_width = frame.network_width, network_height = frame.network_height;
    const float4 law = frame.color_law;
    const int x = get_global_id(0) * LANES, y = get_global_id(1);
    if (x >= target_width || y >= target_height) return;
    const int i = y * target_width + x, plane = network_width * network_height, count = target_width - x;
    const Taps taps = taps_of(x, y, network_width, network_height);
    const Floats m = interpolate(correction + 4 * plane, &taps);
    if (within_mask && !with_refined && !ANY(m >= LEAST_MASK)) {
        const WideRgb none = {0.0f, 0.0f, 0.0f};
        store_some_halfs((Floats)(0.0f), count, focus_mask + i);
        store_where((Ints)(0), none, count, color + 4 * i, out_color + 4 * i);
        return;
    }
    const WideRgb c = finite_rgb(count >= LANES ? load_rgb_run(color + 4 * i)
                                                : gather_rgb(color, i + min((Ints)(LANE_NUMBERS), (Ints)(count - 1))));
    const Floats keep = interpolate(correction + 3 * plane, &taps);
    const Floats low_r = interpolate(frames, &taps);
    const Floats low_g = interpolate(frames + plane, &taps);
    const Floats low_b = interpolate(frames + 2 * plane, &taps);
    const Floats e_r = low_r + interpolate(correction, &taps) + keep * (encode(c.r, law) - low_r);
    const Floats e_g = low_g + interpolate(correction + plane, &taps) + keep * (encode(c.g, law) - low_g);
    const Floats e_b = low_b + interpolate(correction + 2 * plane, &taps) + keep * (encode(c.b, law) - low_b);
    const Ints usable = isfinite(e_r + e_g + e_b + m);
    const Floats mask = (usable & (m >= LEAST_MASK)) ? wide_lesser(m, (Floats)(1.0f)) : (Floats)(0.0f);
    store_some_halfs(mask, count, focus_mask + i);
    const WideRgb made = {decode(e_r, law), decode(e_g, law), decode(e_b, law)};
    if (with_refined) store_where(usable, made, count, color + 4 * i, refined + 4 * i);
    const Floats whole = usable ? (Floats)(1.0f) : (Floats)(0.0f), share = within_mask ? mask : whole, rest = 1.0f - share;
    const WideRgb mixed = {c.r * rest + made.r * share, c.g * rest + made.g * share, c.b * rest + made.b * share};
    store_where(share > 0.0f, mixed, count, color + 4 * i, out_color + 4 * i);
}
