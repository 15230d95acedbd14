/* Position prediction (paper: 'Position estimation'): NP = P_0 + alpha (P_0 - P_1), or the polynomial of order m
   through P_0 ... P_m at their real times. */

#include "common.h"

/* weights[o - 1][i - 1]: factor of (P_i - P_0) in the polynomial of order o <= 4. */
typedef struct { float4 order1, order2, order3, order4; } Polynomial;

/* target_position: (px in the target image, view depth there, 0); depth -1 where there is nothing to splat. */
__kernel void predict_positions(const int source_width, const int source_height, const int order,
                                __global const float *depth, __global const uchar *dynamic_mask,
                                __global const float4 *history, const Polynomial polynomial,
                                const Reprojection to_target, __global float4 *target_position) {
    const int src_x = get_global_id(0), src_y = get_global_id(1);
    if (src_x >= source_width || src_y >= source_height) return;
    const int src = src_y * source_width + src_x, plane = source_width * source_height;
    const float z = depth[src];
    float4 result = (float4)(0.0f, 0.0f, -1.0f, 0.0f);
    if (INVALID_DEPTH(z)) {
        target_position[src] = result;
        return;
    }
    if (!dynamic_mask[src]) {
        result.xyz = reproject(pixel_centre(src_x, src_y), z, to_target);
    } else {
        const float3 p0 = unproject(pixel_centre(src_x, src_y), z, to_target.source_inverse);
        int known = 0;
        while (known < order && history[known * plane + src].w != 0.0f) ++known;
        const float4 weights = known == 1 ? polynomial.order1 : known == 2 ? polynomial.order2
                             : known == 3 ? polynomial.order3 : polynomial.order4;
        const float weight[4] = {weights.x, weights.y, weights.z, weights.w};
        float3 predicted = p0;
        for (int k = 0; k < known; ++k) predicted += weight[k] * (history[k * plane + src].xyz - p0);
        const float3 target_pos = move_to_target(predicted, to_target);
        if (target_pos.z > 0.0f)
            result.xyz = (float3)(project(target_pos, to_target.target), target_pos.z);
    }
    target_position[src] = result;
}
