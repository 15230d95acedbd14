/* Input of the shading correction network at half resolution (paper: 'Shading Correction Network'): encoded colors
   of the extrapolated frame and of the warped previous one, inverse depth and the input mask. */

#include "frame.h"
#include "warped_previous.h"
#include "mu_law.h"

#define BIN_BITS 16       /* dropped from a depth: bins are 1/128 of a power of two wide */
#define BINS 32768
#define COUNTED_ROWS 8    /* depth_histogram counts every eighth row */
#define STRIP 128         /* rows per work-item of depth_histogram: equal bins one after another cost one atomic */
#define SCANNERS 64       /* work-items of find_median */
#define MAX_INVERSE_DEPTH 8.0f

/* Counts how often each bin of finite depth occurs in some of the rows. */
WIDE __kernel void depth_histogram(__constant Frame *restrict frame, __global const float *depth,
                                   __global uint *histogram) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int dst_x = get_global_id(0) * LANES, first = get_global_id(1) * STRIP, count = target_width - dst_x;
    if (dst_x >= target_width) return;
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
__kernel __attribute__((reqd_work_group_size(SCANNERS, 1, 1))) void find_median(__global const uint *histogram,
                                                                                __global float *median_depth) {
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

/* Products of lifted colors, which stay below 1e28: of the left and of the right strips of two rows. */
typedef struct {
    Strip left, right;
} Products;

INLINE Strip lifted_rows(const Strip top, const Strip bottom, const float4 law) {
    Strip product;
#pragma unroll
    for (int part = 0; part < PARTS; ++part)
        product.part[part] = LIFTED(Texels, top.part[part], law) * LIFTED(Texels, bottom.part[part], law);
    return product;
}

#if LANES == 8
DEFINE_DIVIDE(Pairs, divide_pairs)

#define CHANNEL(a, b, c) ((float8)((a).part[0].s##c, (a).part[1].s##c, (b).part[0].s##c, (b).part[1].s##c))
#define LEFT(a, b) {CHANNEL(a, b, 08), CHANNEL(a, b, 19), CHANNEL(a, b, 2a)}
#define RIGHT(a, b) {CHANNEL(a, b, 4c), CHANNEL(a, b, 5d), CHANNEL(a, b, 6e)}
#else
#define LEFT(a, b) {(a).part[0].x, (a).part[0].y, (a).part[0].z}
#define RIGHT(a, b) {(b).part[0].x, (b).part[0].y, (b).part[0].z}
#endif

/* Means over 2x2 pixels, encoded: three planes of the network's input. */
INLINE void store_colors(const Products products, const float4 law, const int plane_size, __global float *planes) {
    const WideRgb left = LEFT(products.left, products.right), right = RIGHT(products.left, products.right);
    const float scale = 0.25f * law.y;
    store_floats(scale * log_of_product(left.r, right.r), 0, planes);
    store_floats(scale * log_of_product(left.g, right.g), 0, planes + plane_size);
    store_floats(scale * log_of_product(left.b, right.b), 0, planes + 2 * plane_size);
}

/* Planes of the network's input: means over 2x2 pixels, the image's border repeated. */
WIDE __kernel void network_input(__constant Frame *restrict frame, __global const half *color,
                                 __global const float *depth, __global const float2 *out_motion,
                                 __global const uchar *is_dynamic, __global const uchar *disoccluded,
                                 __global const float2 *motion, __global const half *color_prev,
                                 __global const float *depth_prev, __global const float *median_depth,
                                 __global float *planes) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int source_width = frame->source_width, source_height = frame->source_height;
    const int network_width = frame->network_width, network_height = frame->network_height;
    const float4 law = frame->color_law;
    const int net_x = get_global_id(0) * LANES, net_y = get_global_id(1);
    if (net_x >= network_width || net_y >= network_height) return;
    const Frames frames = {.known = 1,
                           .target_width = target_width,
                           .source_width = source_width,
                           .source_height = source_height,
                           .color = color,
                           .color_prev = color_prev,
                           .depth = depth,
                           .depth_prev = depth_prev,
                           .out_motion = out_motion,
                           .motion = motion,
                           .is_dynamic = is_dynamic,
                           .disoccluded = disoccluded,
                           .to_previous = &frame->target_to_previous};
    const int plane_size = network_width * network_height;
    __global float *out = planes + net_y * network_width + net_x;

    Floats inverse = 0.0f, mask = 0.0f;
    Products products;
#if LANES == 8
    StripOfFrame strips[4];  /* left, right; of two rows */
    Strip colors[4], before[4];
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        const int x = min(2 * net_x + (k & 1) * LANES, target_width - 1),
                  y = min(2 * net_y + (k >> 1), target_height - 1);
        strips[k] = strip_of_frame(&frames, x, y);
        colors[k] = load_strip(strips[k].count, color + 4 * strips[k].first);
        previous_of(&frames, strips + k, colors + k, before + k);
        before[k] = as_halfs(before[k]);
    }
#pragma unroll
    for (int row = 0; row < 2; ++row) {
        const StripOfFrame *a = strips + 2 * row, *b = a + 1;
        const Pairs near = divide_pairs((Pairs)(*median_depth), (Pairs)(a->depth, b->depth));
        const Pairs nearness = near < MAX_INVERSE_DEPTH ? near : (Pairs)(MAX_INVERSE_DEPTH);
        const Pairs masks = (Pairs)(input_mask_of(a), input_mask_of(b));
        inverse += nearness.even + nearness.odd;
        mask += masks.even + masks.odd;
    }
    products.left = lifted_rows(colors[0], colors[2], law);
    products.right = lifted_rows(colors[1], colors[3], law);
    store_colors(products, law, plane_size, out);
    products.left = lifted_rows(before[0], before[2], law);
    products.right = lifted_rows(before[1], before[3], law);
#else  /* one pixel after another, and colors first: GPUs have no registers for all of them at once */
    float left_nearness = 0.0f, left_mask = 0.0f;
    Strip colors[4];
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        const int x = min(2 * net_x + (k & 1), target_width - 1), y = min(2 * net_y + (k >> 1), target_height - 1);
        colors[k] = load_strip(1, color + 4 * (y * target_width + x));
    }
    products.left = lifted_rows(colors[0], colors[2], law);
    products.right = lifted_rows(colors[1], colors[3], law);
    store_colors(products, law, plane_size, out);
    products.left.part[0] = products.right.part[0] = (Texels)(1.0f);
    for (int k = 0; k < 4; ++k) {
        const int x = min(2 * net_x + (k & 1), target_width - 1), y = min(2 * net_y + (k >> 1), target_height - 1);
        const StripOfFrame here = strip_of_frame(&frames, x, y);
        const Strip gae = load_strip(1, color + 4 * here.first);
        Strip before;
        previous_of(&frames, &here, &gae, &before);
        before = as_halfs(before);
        const Texels lifted = LIFTED(Texels, before.part[0], law);
        const float near = divide(*median_depth, here.depth);
        const float nearness = near < MAX_INVERSE_DEPTH ? near : MAX_INVERSE_DEPTH;
        if (k & 1) {
            products.right.part[0] *= lifted;
            inverse += left_nearness + nearness;
            mask += left_mask + input_mask_of(&here);
        } else {
            products.left.part[0] *= lifted;
            left_nearness = nearness;
            left_mask = input_mask_of(&here);
        }
    }
#endif
    store_colors(products, law, plane_size, out + 3 * plane_size);
    store_floats(0.25f * inverse, 0, out + 6 * plane_size);
    store_floats(0.25f * mask, 0, out + 7 * plane_size);
}
