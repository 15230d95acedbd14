/* Lattices: fences of wire, nets and grids whose wires and gaps alternate at the pitch of pixels. Splatting both apart
   shreds what antialiased colors show as one pattern. So a block moves as one layer, in the plane of its wires, if
   depth steps often in both directions, what is nearest around lies in a plane, nothing moves by itself, and that
   layer's motion explains the frame better from the one before than the motion of each pixel does. */

#include "frame.h"
#include "blocks.h"
#include "encode.h"

/* What set the thresholds: docs/deviations.md, "Lattices move as one layer". */
#define LAYER_STEP 0.92f          /* ratio of depths at a step; what is within it of the nearest depth is near */
#define LOOKED_AROUND 2            /* px around a block that are looked at; its neighbors have as many rows */
#define LEAST_STEPS 44.0f   /* of 288 pixels of 3x3 blocks, in each direction */
#define FEWEST_STEPS 6.0f   /* of a block that counts: more than a straight edge has */
#define DENSE 16.0f         /* near pixels of a block's 32 whose gaps are not seen through */
#define BETTER 0.6f         /* most error as one layer, of that as two, ... */
#define BETTER_DENSE 0.8f   /* ... and in dense blocks */
#define LEAST_BLOCKS 5      /* of 3x3 that determine the plane */
#define WIDER 2             /* blocks to each side over which errors are compared */
#define OFF_PLANE 0.01f     /* relative deviation of their inverse depths from it */

/* Depths of a row's 8 pixels; of what has none, infinity. */
INLINE float8 row_of(__global const float *p) {
    const float8 z = vload8(0, p);
    return z > 0.0f ? z : (float8)(INFINITY);
}

/* How many conditions hold, from their sums by lanes. */
INLINE float count_of(const int8 is) {
    const int4 half_sum = is.lo + is.hi;
    const int2 sum = half_sum.lo + half_sum.hi;
    return (float)-(sum.x + sum.y);
}

/* Steps, of depths that are not NaN. */
INLINE int8 is_step(const float8 a, const float8 b) { return (a < b ? a : b) < LAYER_STEP * (a < b ? b : a); }

/* Brightness of the color codes of LANES pixels. */
INLINE Floats code_luma(__global const half *color, const Ints px, const float offset) {
    Strip s;
    gather_strip(color, px, &s);
    for (int part = 0; part < PARTS; ++part) s.part[part] = encode_texels(finite_texels(s.part[part]), offset);
    const Wide4 code = channels_of(&s);
    return code.c[0] + code.c[1] + code.c[2];
}

/* The squared difference of pixels' brightness to that in the frame before where static surfaces of depth z were;
   negative where those were out of the image. */
INLINE Floats unexplained(const int x, const int y, const Floats z, const Floats luma, const Frame *frame,
                          __global const half *color_prev) {
    const int width = frame->source_width;
    const Wide3 before = wide_reproject(row_centers(x), (Floats)((float)y + 0.5f), z, frame->to_previous);
    const Ints lands = (before.z > 0.0f) & (before.x >= 0.0f) & (before.y >= 0.0f) & (before.x < (float)width)
                       & (before.y < (float)frame->source_height);
    const Ints px = lands ? to_ints(before.y) * width + to_ints(before.x) : (Ints)(0);
    const Floats error = luma - code_luma(color_prev, px, frame->code_offset);
    return lands ? error * error : (Floats)(-1.0f);
}

/* Weighs block number `block`, if there are so many. layer: the mean (x, y, inverse depth) of its near pixels, and how
   many they are. errors: what remains of the frame before along the motion of each pixel, times the share that one
   layer may leave, and along that of one layer; then steps of depth across and down. */
INLINE void weigh_layers(const int block, const Frame *frame, __global const float *depth, __global const half *color,
                         __global const half *color_prev, __global float4 *layer, __global float4 *errors) {
    const int width = frame->source_width, height = frame->source_height, columns = block_columns(width);
    if (block >= columns * block_rows(height)) return;
    const int x0 = block % columns * BLOCK_WIDTH, y0 = block / columns * BLOCK_HEIGHT;
    int8 across = 0, down = 0; /* steps of columns, times -1 */
    const bool whole = x0 >= LOOKED_AROUND && y0 >= LOOKED_AROUND && x0 + BLOCK_WIDTH + LOOKED_AROUND <= width
                       && y0 + BLOCK_HEIGHT + LOOKED_AROUND <= height;
    if (whole && !frame->rests) {
        float8 above = row_of(depth + (y0 - 1) * width + x0);
        for (int y = y0; y < y0 + BLOCK_HEIGHT; ++y) {
            const float8 row = row_of(depth + y * width + x0);
            across += is_step(row, row_of(depth + y * width + x0 - 1));
            down += is_step(row, above);
            above = row;
        }
    }
    layer[block] = (float4)(0.0f);
    errors[block] = (float4)(0.0f);
    if (!(count_of(across + down) >= FEWEST_STEPS)) return;

    float8 nearest = (float8)(INFINITY);
    for (int y = y0 - LOOKED_AROUND; y < y0 + BLOCK_HEIGHT + LOOKED_AROUND; ++y) {
        __global const float *row = depth + y * width + x0;
        nearest = fmin(nearest, fmin(row_of(row - LOOKED_AROUND), row_of(row + LOOKED_AROUND)));
    }
    const float4 of_four = fmin(nearest.lo, nearest.hi);
    const float z_near = fmin(fmin(of_four.x, of_four.y), fmin(of_four.z, of_four.w));
    float4 sum = (float4)(0.0f);
    float apart = 0.0f, together = 0.0f;
    for (int k = 0; k < BLOCK_WIDTH * BLOCK_HEIGHT; k += LANES) {
        const int x = x0 + k % BLOCK_WIDTH, y = y0 + k / BLOCK_WIDTH, px = y * width + x;
        const Floats z = load_floats(0, depth + px), inverse = wide_divide((Floats)(1.0f), z);
        const Floats luma = code_luma(color, px + LANE_NUMBERS, frame->code_offset);
        const Floats as_two = unexplained(x, y, z, luma, frame, color_prev),
                     as_one = unexplained(x, y, (Floats)(z_near), luma, frame, color_prev);
        const Ints is_near = (z > 0.0f) & (LAYER_STEP * z < z_near),
                   compares = (z > 0.0f) & !(as_two < 0.0f) & !(as_one < 0.0f);
        for (int lane = 0; lane < LANES; ++lane) {
            if (int_of(&is_near, lane)) sum += (float4)(pixel_center(x + lane, y), float_of(&inverse, lane), 1.0f);
            if (!int_of(&compares, lane)) continue;
            apart += float_of(&as_two, lane);
            together += float_of(&as_one, lane);
        }
    }
    if (sum.w > 0.0f) layer[block] = (float4)(mean_of(sum.xyz, sum.w), sum.w);
    errors[block] =
        (float4)(apart * (sum.w >= DENSE ? BETTER_DENSE : BETTER), together, count_of(across), count_of(down));
}

/* Of block k of 3x3, the mean place of its near pixels from `center`, their inverse depth relative to the middle
   block's, and how many they are. */
INLINE float4 part_of(__global const float4 *layer, const int columns, const int k, const float2 center,
                      const float per_own) {
    const float4 there = layer[(k / 3 - 1) * columns + k % 3 - 1];
    return (float4)(there.xy - center, there.z * per_own - 1.0f, there.w);
}

/* The plane through the near pixels of 3x3 blocks around the one at `layer`: inverse depth at `center`, and its slopes;
   0 where they lie in none. */
INLINE float3 plane_of(__global const float4 *layer, const int columns, const float2 center) {
    const float3 none = (float3)(0.0f);
    const float per_own = divide(1.0f, layer[0].z);
    float3 sum = none;
    float count = 0.0f;
    int blocks = 0;
#pragma unroll 1
    for (int k = 0; k < 9; ++k) {
        const float4 part = part_of(layer, columns, k, center, per_own);
        sum += part.w * part.xyz;
        count += part.w;
        blocks += part.w > 0.0f;
    }
    const float3 mean = mean_of(sum, count);
    float3 by_x = none, by_y = none; /* sums of the products with x, and with y */
#pragma unroll 1
    for (int k = 0; k < 9; ++k) {
        const float4 part = part_of(layer, columns, k, center, per_own);
        const float3 off = part.xyz - mean;
        by_x += part.w * off.x * off;
        by_y += part.w * off.y * off;
    }
    const float det = by_x.x * by_y.y - by_x.y * by_y.x;
    if (blocks < LEAST_BLOCKS || !(det > count * count)) return none;
    const float along = divide(by_x.z * by_y.y - by_y.z * by_x.y, det),
                down = divide(by_y.z * by_x.x - by_x.z * by_y.x, det);
#pragma unroll 1
    for (int k = 0; k < 9; ++k) {
        const float4 part = part_of(layer, columns, k, center, per_own);
        const float3 off = part.xyz - mean;
        if (part.w > 0.0f && !(fabs(off.z - along * off.x - down * off.y) <= OFF_PLANE)) return none;
    }
    const float at_center = 1.0f + mean.z - along * mean.x - down * mean.y;
    const bool is_before = at_center > 0.5f * (float)BLOCK_WIDTH * (fabs(along) + fabs(down));
    return is_before ? layer[0].z * (float3)(at_center, along, down) : none;
}

/* Whether a block is part of a lattice if nothing moves in it: then *plane is its layer's inverse depth at the block's
   center, and its slopes per pixel. Those at the image's border are not. */
INLINE bool is_lattice(const int block, const int columns, const int rows, __global const float4 *layer,
                       __global const float4 *errors, float3 *plane) {
    if (!(layer[block].w > 0.0f)) return false;
    const int bx = block % columns, by = block / columns;
    if (bx < 1 || by < 1 || bx >= columns - 1 || by >= rows - 1) return false;
    float2 steps = (float2)(0.0f); /* of 3x3 blocks; those who have too few are spared the rest */
#pragma unroll 1
    for (int k = 0; k < 9; ++k) steps += errors[block + (k / 3 - 1) * columns + k % 3 - 1].zw;
    if (!(steps.x >= LEAST_STEPS && steps.y >= LEAST_STEPS)) return false;
    float apart = 0.0f, together = 0.0f;
#pragma unroll 1
    for (int y = max(by - WIDER, 0); y <= min(by + WIDER, rows - 1); ++y)
        for (int x = max(bx - WIDER, 0); x <= min(bx + WIDER, columns - 1); ++x) {
            const float4 there = errors[y * columns + x];
            apart += there.x;
            together += there.y;
        }
    if (!(together < apart)) return false;
    const float2 center = ((float2)((float)bx, (float)by) + 0.5f) * (float2)((float)BLOCK_WIDTH, (float)BLOCK_HEIGHT);
    *plane = plane_of(layer + block, columns, center);
    return plane->x > 0.0f;
}

/* Finds which of block number `block`, if there are so many, and those beside it are part of lattices, as bits of
   `links`. */
INLINE void find_lattices(const int block, __constant Frame *frame, __global const float4 *layer,
                          __global const float4 *errors, __global uchar *lattices, __global float4 *plane) {
    const int columns = block_columns(frame->source_width), rows = block_rows(frame->source_height);
    if (block >= columns * rows) return;
    uchar found = 0;
#pragma unroll 1
    for (int k = 0; k < 5; ++k) { /* beyond the border are blocks that are at the border, too */
        const int beside = block + (k == 0) - (k == 2) + ((k == 1) - (k == 3)) * columns;
        float3 own;
        if (!is_lattice(clamp(beside, 0, columns * rows - 1), columns, rows, layer, errors, &own)) continue;
        found |= LINK_RIGHT << k;
        if (k == 4) plane[block] = (float4)(own, 0.0f);
    }
    lattices[block] = found;
}
