/* Extrapolation by dilated and splatted motion vectors, in the manner of Mob-FGSR (Yang et al., SIGGRAPH 2024), to
   compare with: the cheapest method that moves vectors with a depth test. It needs no camera and no frame before.

   splat: each pixel takes the vector and the depth of the nearest pixel of the 3x3 around it (dilation), so that
   antialiased edges move along with the nearer surface. It carries the vector to where that leads at t + alpha. There
   the nearest one wins (nearest.h), of one depth the least word: two components in 1/STEPS px.
   warp: each pixel looks its color up backward along its vector, bilinear. A pixel without one takes that of the
   nearest surface beside: what a surface uncovers is what was seen beside it. Else it keeps the rendered frame's own.

   `keys` and `winners` are what the splat leaves: the least depth that reached each pixel, and its word. */

#include "../common.h"
#include "../sampling.h"
#include "../simd_texels.h"
#include "../nearest.h"
#include "../dilation.h"

/* LANES pixels per work-item. */
WIDE __kernel void splat(const int width, const int height, const float alpha, const int pass,
                         __global const float *depth, __global const float2 *motion, __global Key *keys,
                         __global uint *winners) {
    const int x = get_global_id(0) * LANES, y = get_global_id(1);
    if (x >= width || y >= height) return;
    Ints nearest;
    const Floats z = find_nearest(depth, x, y, width, height, &nearest);
    Floats motion_y;
    const Floats motion_x = gather_xy(motion, nearest, &motion_y);
    const Floats move_x = -alpha * motion_x, move_y = -alpha * motion_y;
    const Floats px_x = row_centers(x) + move_x, px_y = ((float)y + 0.5f) + move_y;
    const Ints lands = (fabs(move_x) <= LONGEST) & (fabs(move_y) <= LONGEST) & (px_x >= 0.0f) & (px_x < (float)width)
                       & (px_y >= 0.0f) & (px_y < (float)height);
    if (!ANY(lands)) return;
    offer_vectors(pass, keys, winners, width - x, width, lands, px_x, px_y, move_x, move_y, z);
}

/* The vector for a pixel that none reached. */
INLINE float2 filling_vector(__global const Key *keys, __global const uint *winners, __global const float2 *motion,
                             const int x, const int y, const int width, const int height, const float alpha) {
    const Origin any = {.z = 0};
    const uint word = nearest_beside(keys, winners, x, y, width, height, any);
    if (word != NOBODY) return components(word);
    const float2 own = -alpha * motion[y * width + x];
    return (float2)(own.x == own.x ? own.x : 0.0f, own.y == own.y ? own.y : 0.0f);
}

/* LANES pixels per work-item. */
WIDE __kernel void warp(const int width, const int height, const float alpha, __global const Key *keys,
                        __global const uint *winners, __global const float2 *motion, __global const half *color,
                        __global half *out_color) {
    const int x = get_global_id(0) * LANES, y = get_global_id(1), dst = y * width + x, count = width - x;
    if (x >= width || y >= height) return;
    const Uints word = load_some_winners(count, keys, winners, dst);
    Floats move_x = component(word & 0xFFFFu), move_y = component(word >> 16);
    if (ANY(word == NOBODY)) {
        for (int k = 0; k < min(LANES, count); ++k) {
            if (uint_of(&word, k) != NOBODY) continue;
            const float2 move = filling_vector(keys, winners, motion, x + k, y, width, height, alpha);
            set_float(&move_x, k, move.x);
            set_float(&move_y, k, move.y);
        }
    }
    Sample from;
    find_sample(row_indices(x) - move_x, (float)y - move_y, width, height, &from);
    const bool in_row = ALL((from.tap == FIRST_LANE(from.tap) + LANE_NUMBERS) & (from.right == 1));
    const Ints below = from.tap + from.down, taps[4] = {from.tap, from.tap + from.right, below, below + from.right};
    Strip made;
#pragma unroll
    for (int part = 0; part < PARTS; ++part) {
        const Texels u = OF_TEXELS(from.u, part), v = OF_TEXELS(from.v, part);
        Texels c[4];
#pragma unroll
        for (int k = 0; k < 4; ++k) c[k] = gather_texels(color, taps[k], part, in_row);
        made.part[part] = (1.0f - v) * ((1.0f - u) * c[0] + u * c[1]) + v * ((1.0f - u) * c[2] + u * c[3]);
    }
    store_strip(made, count, out_color + 4 * dst);
}
