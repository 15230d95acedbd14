/* Hole filling: what is still invalid is continued from the far side of the disocclusion, or comes from the image
   downsampled 32 times (paper: 'Shading correction network'). */

#include "common.h"

#define BLOCK 32
#define RENDERED_WEIGHT 0.0009765625f  /* of the rendered frame beside valid pixels: decides only where there are none */

/* Adds a pixel to the sums; bright pixels weigh less, or one lamp would fill its whole block. */
inline void add(float4 *sum, float *inverse_sum, const float pixel_weight, const float3 c, const float z) {
    const float weight = divide(pixel_weight, 1.0f + fmax(fmax(c.x, fmax(c.y, c.z)), 0.0f));
    *sum += weight * (float4)(c, 1.0f);
    *inverse_sum += weight * (isinf(z) ? 0.0f : divide(1.0f, z));
}

/* Weighted sums over 32x32 blocks: (colour, 1) and inverse depth; zeros where no hole asks for them. One work-group of 32 per
   block, one column each. */
__kernel void downsample(const int target_width, const int target_height, const int source_width, const int source_height,
                         const int blocks_width, __global const uint *beyond_reach, __global const half *color,
                         __global const float *depth,
                         __global const uchar *filled_by, __global const half *source_color,
                         __global const float *source_depth, __global float4 *block_color,
                         __global float *block_inverse_depth) {
    __local float4 column_color[BLOCK];
    __local float column_inverse_depth[BLOCK];
    const int lane = get_local_id(0);
    const int bx = get_group_id(0), by = get_group_id(1);
    const int dst_x = bx * BLOCK + lane;
    float4 sum = (float4)(0.0f);
    float inverse_sum = 0.0f;
    const int rows = beyond_reach[0] ? BLOCK : 0;
    for (int k = 0; k < rows; ++k) {
        const int dst_y = by * BLOCK + k;
        if (dst_x >= target_width || dst_y >= target_height) break;
        const int dst = dst_y * target_width + dst_x;
        if (filled_by[dst] != BY_HOLE_FILLING) {
            add(&sum, &inverse_sum, 1.0f, load_color(color, dst), depth[dst]);
        }
        const int src = (dst_y * source_height / target_height) * source_width + dst_x * source_width / target_width;
        const float z = source_depth[src];
        if (!INVALID_DEPTH(z)) add(&sum, &inverse_sum, RENDERED_WEIGHT, load_color(source_color, src), z);
    }
    column_color[lane] = sum;
    column_inverse_depth[lane] = inverse_sum;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lane != 0) return;
    for (int k = 1; k < BLOCK; ++k) {
        sum += column_color[k];
        inverse_sum += column_inverse_depth[k];
    }
    block_color[by * blocks_width + bx] = sum;
    block_inverse_depth[by * blocks_width + bx] = inverse_sum;
}

/* ---- far side ------------------------------------------------------------------------------------------------ */

#define DIRECTIONS 8
#define FAR_SIDE 1.3f            /* inverse depths up to this times the least belong to the far side */

/* What a disocclusion shows is the surface on its far side, continued: of the first valid pixels in eight directions, up
   to `reach` px away, the mean of those on the far side, weighted by the inverse of their distance.
   Gives (colour, inverse depth); false where no direction meets a valid pixel. */
inline bool far_side(const int dst_x, const int dst_y, const int target_width, const int target_height, const int reach,
                     __global const uchar *filled_by, __global const half *color, __global const float *depth,
                     float4 *mean) {
    int met[DIRECTIONS];
    float inverse[DIRECTIONS], weight[DIRECTIONS];
    float least = INFINITY;
    int count = 0;
    for (int k = 0; k < DIRECTIONS; ++k) {
        const int dx = k < 3 ? 1 : k < 6 ? -1 : 0, dy = k == 7 ? -1 : k == 6 ? 1 : k % 3 - 1;
        const float step = dx && dy ? 1.41421356f : 1.0f;
        for (int t = 1; (float)t * step <= (float)reach; ++t) {
            const int beside_x = dst_x + t * dx, beside_y = dst_y + t * dy;
            if (!inside(beside_x, beside_y, target_width, target_height)) break;
            const int beside = beside_y * target_width + beside_x;
            if (filled_by[beside] == BY_HOLE_FILLING) continue;
            met[count] = beside;
            inverse[count] = isinf(depth[beside]) ? 0.0f : divide(1.0f, depth[beside]);
            weight[count] = divide(1.0f, (float)t * step);
            least = fmin(least, inverse[count]);
            ++count;
            break;
        }
    }
    float4 sum = (float4)(0.0f);
    float weight_sum = 0.0f;
    for (int k = 0; k < count; ++k) {
        if (inverse[k] > least * FAR_SIDE) continue;
        sum += weight[k] * (float4)(load_color(color, met[k]), inverse[k]);
        weight_sum += weight[k];
    }
    if (count == 0) return false;
    *mean = (float4)(divide(sum.x, weight_sum), divide(sum.y, weight_sum), divide(sum.z, weight_sum), divide(sum.w,
                                                                                                             weight_sum));
    return true;
}

/* ---- push-pull (Gortler et al., The Lumigraph, 1996) ------------------------------------------------------------ */

/* Mean (colour, inverse depth) and weight, 0 or 1, of the valid pixels among the 2x2 under each texel of level 1. */
__kernel void push_image(const int target_width, const int target_height, const int level_width, const int level_height,
                         __global const uchar *filled_by, __global const half *color, __global const float *depth,
                         __global float4 *mean, __global float *weight) {
    const int texel_x = get_global_id(0), texel_y = get_global_id(1);
    if (texel_x >= level_width || texel_y >= level_height) return;
    float4 sum = (float4)(0.0f);
    float inverse_sum = 0.0f;
    for (int k = 0; k < 4; ++k) {
        const int dst_x = 2 * texel_x + (k & 1), dst_y = 2 * texel_y + (k >> 1);
        if (!inside(dst_x, dst_y, target_width,
                    target_height) || filled_by[dst_y * target_width + dst_x] == BY_HOLE_FILLING) continue;
        add(&sum, &inverse_sum, 1.0f, load_color(color, dst_y * target_width + dst_x), depth[dst_y * target_width + dst_x]);
    }
    const bool any = sum.w > 0.0f;
    const float size = any ? divide(1.0f, sum.w) : 0.0f;
    mean[texel_y * level_width + texel_x] = (float4)(sum.x * size, sum.y * size, sum.z * size, inverse_sum * size);
    weight[texel_y * level_width + texel_x] = any ? 1.0f : 0.0f;
}

/* The same from one level to the next; weights add up to at most 1. */
__kernel void push_level(const int fine_width, const int fine_height, const int level_width, const int level_height,
                         __global const float4 *fine_mean, __global const float *fine_weight, __global float4 *mean,
                         __global float *weight) {
    const int texel_x = get_global_id(0), texel_y = get_global_id(1);
    if (texel_x >= level_width || texel_y >= level_height) return;
    float4 sum = (float4)(0.0f);
    float weight_sum = 0.0f;
    for (int k = 0; k < 4; ++k) {
        const int fine_x = 2 * texel_x + (k & 1), fine_y = 2 * texel_y + (k >> 1);
        if (!inside(fine_x, fine_y, fine_width, fine_height)) continue;
        const float w = fine_weight[fine_y * fine_width + fine_x];
        sum += w * fine_mean[fine_y * fine_width + fine_x];
        weight_sum += w;
    }
    const float size = weight_sum > 0.0f ? divide(1.0f, weight_sum) : 0.0f;
    mean[texel_y * level_width + texel_x] = sum * size;
    weight[texel_y * level_width + texel_x] = fmin(weight_sum, 1.0f);
}

/* Bilinear interpolation of a level at texel position (x + 0.5, y + 0.5) / 2 of the next finer one. */
inline float4 upsampled(const int x, const int y, const int level_width, const int level_height,
                        __global const float4 *mean) {
    const float u = (x & 1) ? 0.25f : 0.75f, v = (y & 1) ? 0.25f : 0.75f;
    const int x0 = (x - 1) >> 1, y0 = (y - 1) >> 1;
    float4 sum = (float4)(0.0f);
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = clamp(x0 + (tap & 1), 0, level_width - 1), tap_y = clamp(y0 + (tap >> 1), 0, level_height - 1);
        sum += bilinear_weight(tap, u, v) * mean[tap_y * level_width + tap_x];
    }
    return sum;
}

/* Completes a level, in place, where it is not full, from the coarser one. */
__kernel void pull_level(const int level_width, const int level_height, const int coarse_width, const int coarse_height,
                         __global const float4 *coarse_mean, __global float4 *mean, __global const float *weight) {
    const int texel_x = get_global_id(0), texel_y = get_global_id(1);
    if (texel_x >= level_width || texel_y >= level_height) return;
    const int texel = texel_y * level_width + texel_x;
    const float w = weight[texel];
    if (w < 1.0f) mean[texel] = w * mean[texel] + (1.0f - w) * upsampled(texel_x, texel_y, coarse_width, coarse_height,
                                                                         coarse_mean);
}

/* ---- fill ------------------------------------------------------------------------------------------------------ */

/* Bilinear interpolation of the block means: (colour, inverse depth). */
inline float4 block_mean(const int dst_x, const int dst_y, const int blocks_width, const int blocks_height,
                         __global const float4 *block_color, __global const float *block_inverse_depth) {
    const float bx = ((float)dst_x + 0.5f) * (1.0f / BLOCK) - 0.5f, by = ((float)dst_y + 0.5f) * (1.0f / BLOCK) - 0.5f;
    const int x0 = (int)floor(bx), y0 = (int)floor(by);
    const float u = bx - (float)x0, v = by - (float)y0;
    float4 sum = (float4)(0.0f);
    float inverse_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = clamp(x0 + (tap & 1), 0, blocks_width - 1), tap_y = clamp(y0 + (tap >> 1), 0, blocks_height - 1);
        const float weight = bilinear_weight(tap, u, v);
        sum += weight * block_color[tap_y * blocks_width + tap_x];
        inverse_sum += weight * block_inverse_depth[tap_y * blocks_width + tap_x];
    }
    if (!(sum.w > 0.0f)) return (float4)(0.0f);
    return (float4)(divide(sum.x, sum.w), divide(sum.y, sum.w), divide(sum.z, sum.w), divide(inverse_sum, sum.w));
}

inline void fill_pixel(const int dst_x, const int dst_y, const int dst, const float4 mean, const Reprojection to_source,
                       __global half *color, __global float *depth, __global float2 *motion) {
    const float z = mean.w > 0.0f ? divide(1.0f, mean.w) : INFINITY;
    const float2 centre = pixel_centre(dst_x, dst_y);
    const float3 px_source = reproject(centre, z, to_source);
    store_color(mean.xyz, color, dst);
    depth[dst] = z;
    motion[dst] = px_source.z > 0.0f ? px_source.xy - centre : (float2)(0.0f);
}

/* Fills what is still invalid from the far side; motion is that of a static point. Only pixels that were valid before are read.
   *beyond_reach: whether there are holes without one. */
SPARSE __kernel void fill_far_side(const int target_width, const int target_height, const int reach,
                                   __global const uchar *filled_by, const Reprojection to_source, __global half *color,
                                   __global float *depth, __global float2 *motion, __global uint *beyond_reach) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    if (filled_by[dst] != BY_HOLE_FILLING) return;
    float4 mean;
    if (far_side(dst_x, dst_y, target_width, target_height, reach, filled_by, color, depth, &mean))
        fill_pixel(dst_x, dst_y, dst, mean, to_source, color, depth, motion);
    else
        atomic_or(beyond_reach, 1u);
}

/* Fills the rest from the block means. */
SPARSE __kernel void fill_from_blocks(const int target_width, const int target_height, const int blocks_width,
                                      const int blocks_height, const int reach, __global const uint *beyond_reach,
                                      __global const uchar *filled_by, __global const float4 *block_color,
                                      __global const float *block_inverse_depth, const Reprojection to_source,
                                      __global half *color, __global float *depth, __global float2 *motion) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (!beyond_reach[0] || dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    if (filled_by[dst] != BY_HOLE_FILLING) return;
    float4 mean;
    if (far_side(dst_x, dst_y, target_width, target_height, reach, filled_by, color, depth, &mean)) return;
    mean = block_mean(dst_x, dst_y, blocks_width, blocks_height, block_color, block_inverse_depth);
    fill_pixel(dst_x, dst_y, dst, mean, to_source, color, depth, motion);
}

/* Labels what was filled: apart from filling, which reads the labels of its surroundings. */
__kernel void label_filled(const int target_width, const int target_height, __global uchar *filled_by) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    if (filled_by[dst] == BY_HOLE_FILLING) filled_by[dst] = BY_HOLE_FILLING;
}

/* Fills all of it, from the completed level 1 of push-pull. */
__kernel void fill_from_pyramid(const int target_width, const int target_height, const int level_width,
                                const int level_height,
                                __global const uchar *filled_by, __global const float4 *level_mean,
                                const Reprojection to_source, __global half *color, __global float *depth,
                                __global float2 *motion) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1);
    if (dst_x >= target_width || dst_y >= target_height) return;
    const int dst = dst_y * target_width + dst_x;
    if (filled_by[dst] != BY_HOLE_FILLING) return;
    fill_pixel(dst_x, dst_y, dst, upsampled(dst_x, dst_y, level_width, level_height, level_mean), to_source, color,
               depth, motion);
}
