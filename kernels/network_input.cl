/* Input of the shading correction network at half resolution (paper: 'Shading Correction Network'): encoded colors
   of the extrapolated frame and of the warped previous one, inverse depth and the input mask. */

#include "frame.h"
#include "doubling.h"
#include "warped_previous.h"
#include "mu_law.h"

#define SCANNERS 256 /* work-items of find_median */
#define LATTICE_X 64 /* depths that it looks at, over an image of any size, ... */
#define LATTICE_Y 36
#define SAMPLES 9 /* ... and of a work-item */
#define ROUNDS 15 /* bits of the median that are found, after the sign */
#define MAX_INVERSE_DEPTH 8.0f

/* The median of the lattice's finite depths, to 1/256; 1 if there are none. It is found bit by bit: the largest number
   below which less than half of the depths are. One work-group. */
__kernel __attribute__((reqd_work_group_size(SCANNERS, 1, 1))) void
find_median(__constant Frame *restrict frame, __global const float *depth, __global float *median_depth) {
    const int target_width = frame->target_width, target_height = frame->target_height, item = get_local_id(0);
    __local uint below[ROUNDS], total;
    if (item < ROUNDS) below[item] = 0;
    if (item == 0) total = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    uint bits[SAMPLES], known = 0;
#pragma unroll
    for (int k = 0; k < SAMPLES; ++k) {
        const int at = k * SCANNERS + item;
        const int x = (2 * (at % LATTICE_X) + 1) * target_width / (2 * LATTICE_X);
        const int y = (2 * (at / LATTICE_X) + 1) * target_height / (2 * LATTICE_Y);
        const float z = depth[y * target_width + x];
        const bool is_known = z > 0.0f && !isinf(z);
        bits[k] = is_known ? as_uint(z) : UINT_MAX;
        known += is_known;
    }
    atomic_add(&total, known);
    barrier(CLK_LOCAL_MEM_FENCE);
    const uint half_way = (total + 1) / 2;
    uint found = 0;
    for (int round = 0; round < ROUNDS; ++round) {
        const uint tried = found | 1u << (30 - round);
        uint count = 0;
#pragma unroll
        for (int k = 0; k < SAMPLES; ++k) count += bits[k] < tried;
        atomic_add(below + round, count);
        barrier(CLK_LOCAL_MEM_FENCE);
        if (below[round] < half_way) found = tried;
    }
    if (item == 0) *median_depth = total ? as_float(found | 1u << (30 - ROUNDS)) : 1.0f;
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

/* Means over 2x2 pixels, encoded: three planes of the network's input. */
INLINE void store_colors(const Products products, const float4 law, const int plane_size, __global float *planes) {
    const Wide4 first = channels_of(&products.left), second = channels_of(&products.right);
    for (int c = 0; c < 3; ++c) {
        const Floats left = EVEN_OF(first.c[c], second.c[c]), right = ODD_OF(first.c[c], second.c[c]);
        store_floats(0.25f * law.y * log_of_product(left, right), 0, planes + c * plane_size);
    }
}

/* Indices of 2x2 pixels, LANES times, from (x, y) on: upper left and right, lower left and right; the image's border is
   repeated. */
INLINE void find_pixels(const int x, const int y, const int width, const int height, Ints *at) {
    const int top = min(y, height - 1) * width, bottom = min(y + 1, height - 1) * width;
    const Ints column = x + 2 * LANE_NUMBERS;
    const Ints left = min(column, (Ints)(width - 1)), right = min(column + 1, (Ints)(width - 1));
    at[0] = top + left;
    at[1] = top + right;
    at[2] = bottom + left;
    at[3] = bottom + right;
}

/* Values of these pixels; `whole`: they are all in the image. */
INLINE void load_pixels(__global const float *plane, const Ints *at, const bool whole, Floats *part) {
    if (whole) {
        const Pairs top = load_pairs(plane + FIRST_LANE(at[0])), bottom = load_pairs(plane + FIRST_LANE(at[2]));
        part[0] = top.even;
        part[1] = top.odd;
        part[2] = bottom.even;
        part[3] = bottom.odd;
    } else {
        for (int k = 0; k < 4; ++k) part[k] = gather_floats(plane, at[k]);
    }
}

INLINE void find_set_pixels(__global const uchar *mask, const Ints *at, const bool whole, Ints *part) {
    if (whole) {
        const BytePairs top = load_pairs(mask + FIRST_LANE(at[0])), bottom = load_pairs(mask + FIRST_LANE(at[2]));
        const Bytes pixels[4] = {top.even, top.odd, bottom.even, bottom.odd};
        for (int k = 0; k < 4; ++k) part[k] = to_ints(pixels[k]) != 0;
    } else {
        for (int k = 0; k < 4; ++k) part[k] = to_ints(gather_bytes(mask, at[k])) != 0;
    }
}

/* Product of lifted colors of t-1 of a smooth quad, from pixel `dst` on: of its left and of its right pixels; false if
   they are not finite. */
INLINE bool product_between(const Frames *f, const int dst, const int tap, const float u, const float v,
                            const float nearest, const float farthest, const float4 law, float8 *product) {
    const int width = f->frame->source_width, second = tap + width, third = second + width;
    const int3 same_a = of_surface(f->depth_prev, tap, nearest, farthest),
               same_b = of_surface(f->depth_prev, second, nearest, farthest),
               same_c = of_surface(f->depth_prev, third, nearest, farthest);
    float8 top, bottom;
    if (all(same_a & same_b & same_c)) {
        const float8 a = between_texels(f->color_prev, tap, u), b = between_texels(f->color_prev, second, u),
                     c = between_texels(f->color_prev, third, u);
        top = a + v * (b - a);
        bottom = b + v * (c - b);
    } else {
        float8 weight_a, weight_b, weight_c;
        const float8 a = between_some(f->color_prev, tap, u, same_a, &weight_a),
                     b = between_some(f->color_prev, second, u, same_b, &weight_b),
                     c = between_some(f->color_prev, third, u, same_c, &weight_c);
        top = mean_of_some(f, dst, v, a, b, weight_a, weight_b);
        bottom = mean_of_some(f, dst + f->frame->target_width, v, b, c, weight_b, weight_c);
    }
    *product = LIFTED(float8, top, law) * LIFTED(float8, bottom, law);
    return all((fabs(top) <= COLOR_MAX) & (fabs(bottom) <= COLOR_MAX));
}

/* The same of any quad, from pixel (x, y) on. */
INLINE float8 product_of_pixels(const Frames *f, const int x, const int y, const float4 law) {
    const int width = f->frame->target_width, height = f->frame->target_height;
    float4 left = (float4)(1.0f), right = left;
#pragma unroll 1
    for (int k = 0; k < 4; ++k) {
        const float4 before = previous_at(f, min(x + (k & 1), width - 1), min(y + (k >> 1), height - 1));
        const float4 lifted = LIFTED(float4, before, law);
        if (k & 1)
            right *= lifted;
        else
            left *= lifted;
    }
    return (float8)(left, right);
}

/* Planes of the network's input: means over 2x2 pixels, the image's border repeated. */
WIDE __kernel void network_input(__constant Frame *restrict frame, __global const half *color,
                                 __global const float *depth, __global const float2 *out_motion,
                                 __global const uchar *is_dynamic, __global const uchar *disoccluded,
                                 __global const float2 *motion, __global const half *color_prev,
                                 __global const float *depth_prev, __global const float *median_depth,
                                 __global float *planes) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int network_width = frame->network_width, network_height = frame->network_height;
    const float4 law = frame->color_law;
    const int net_x = get_global_id(0) * LANES, net_y = get_global_id(1);
    if (net_x >= network_width || net_y >= network_height) return;
    const Frames frames = {frame, color, color_prev, depth, depth_prev, out_motion, motion, is_dynamic, disoccluded};
    const int plane_size = network_width * network_height;
    __global float *out = planes + net_y * network_width + net_x;

    Products products;
    Strip colors[4]; /* left, right; of two rows */
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        const int x = min(2 * net_x + (k & 1) * LANES, target_width - 1),
                  y = min(2 * net_y + (k >> 1), target_height - 1);
        colors[k] = load_strip(target_width - x, color + 4 * (y * target_width + x));
    }
    products.left = lifted_rows(colors[0], colors[2], law);
    products.right = lifted_rows(colors[1], colors[3], law);
    store_colors(products, law, plane_size, out);

    const bool whole = 2 * (net_x + LANES) <= target_width && 2 * net_y + 2 <= target_height;
    Ints at[4], moves[4], hidden[4];
    Floats nearness[4], inverse[4], masks[4];
    find_pixels(2 * net_x, 2 * net_y, target_width, target_height, at);
    load_pixels(depth, at, whole, nearness);
    find_set_pixels(is_dynamic, at, whole, moves);
    find_set_pixels(disoccluded, at, whole, hidden);
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        nearness[k] = 1.0f / nearness[k];
        const Floats near = *median_depth * nearness[k];
        inverse[k] = near < MAX_INVERSE_DEPTH ? near : (Floats)(MAX_INVERSE_DEPTH);
        masks[k] = input_masks(moves[k], hidden[k]);
    }
    store_floats(0.25f * ((inverse[0] + inverse[1]) + (inverse[2] + inverse[3])), 0, out + 6 * plane_size);
    store_floats(0.25f * ((masks[0] + masks[1]) + (masks[2] + masks[3])), 0, out + 7 * plane_size);

    Quads quads =
        find_quads(&frames, at[0], 2.0f * to_floats(net_x + LANE_NUMBERS) + 1.0f, 2.0f * (float)net_y + 1.0f, nearness,
                   moves[0] & moves[1] & moves[2] & moves[3], moves[0] | moves[1] | moves[2] | moves[3]);
    float texels[8 * LANES];
    for (int k = 0; k < LANES; ++k) {
        const int x = 2 * (net_x + k), y = 2 * net_y;
        const bool is_inside = x + 2 <= target_width && y + 2 <= target_height;
        float8 product;
        if (!(is_inside && int_of(&quads.smooth, k)
              && product_between(&frames, y * target_width + x, int_of(&quads.tap, k), float_of(&quads.u, k),
                                 float_of(&quads.v, k), float_of(&quads.nearest, k), float_of(&quads.farthest, k), law,
                                 &product)))
            product = product_of_pixels(&frames, x, y, law);
        vstore8(product, k, texels);
    }
#pragma unroll
    for (int part = 0; part < PARTS; ++part) {
        products.left.part[part] = reload_texels(part, texels);
        products.right.part[part] = reload_texels(PARTS + part, texels);
    }
    store_colors(products, law, plane_size, out + 3 * plane_size);
}
