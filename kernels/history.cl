/* History tracking (paper: 'Motion estimation', appendix Algorithm 1).
   Positions are in the view space of the current rendered camera: P_0 is what depth gives, P_1 ... P_{k-1} are stored. */

#include "common.h"

#define RESIDUAL_BINS 64
#define RESIDUAL_FIRST_BIN 214   /* bits of 2^-20 >> 22: the squared residual of the first bin, in px^2 */
#define RESIDUAL_STRIDE 4        /* every 4th pixel of every 4th row is enough for a quantile */
#define SCATTER_DISTANCE 8       /* px, diagonally: far enough for quantisation errors to differ, near enough for one surface */

#define SEARCH_RADIUS 2          /* px around x' in which the right surface is looked for */
#define DEPTH_TOLERANCE 0.03f    /* relative depth within which a surface is plausible for a fragment that stands ... */
#define DEPTH_PER_MOTION 2.0f    /* ... and what is added per unit of its sideways motion */
#define DEPTH_CHANGE_MOST 0.12f  /* relative change within an interval of a surface that fills the neighbourhood of x' */

/* Where pixel (x, y) of depth z was if it is static: (px in the previous frame, z there). */
inline float3 static_position(const int src_x, const int src_y, const float z, const Reprojection to_previous) {
    return reproject(pixel_centre(src_x, src_y), z, to_previous);
}

inline float2 previous_position(const int src_x, const int src_y, const float2 mv_px) {
    return pixel_centre(src_x, src_y) + mv_px;
}

inline float squared_distance(const float2 a, const float2 b) {
    const float dx = a.x - b.x, dy = a.y - b.y;
    return dx * dx + dy * dy;
}

/* Residual x^ - x' of the static test at a pixel; false where it does not apply. */
inline bool static_residual(const int src_x, const int src_y, const int source_width, __global const float *depth,
                            __global const float2 *motion, const Reprojection to_previous, float2 *residual) {
    const float z = depth[src_y * source_width + src_x];
    const float2 mv_px = motion[src_y * source_width + src_x];
    if (INVALID_DEPTH(z) || isinf(z) || !isfinite(mv_px.x) || !isfinite(mv_px.y)) return false;
    const float3 px_static = static_position(src_x, src_y, z, to_previous);
    *residual = px_static.xy - previous_position(src_x, src_y, mv_px);
    return px_static.z > 0.0f;
}

inline int residual_bin(const float2 residual) {
    const float r2 = residual.x * residual.x + residual.y * residual.y;
    return clamp((int)(as_uint(r2) >> 22) - RESIDUAL_FIRST_BIN, 0, RESIDUAL_BINS - 1);
}

/* Two histograms over a subset of the pixels, two bins per octave: of the squared residual, and of its squared change over a
   short distance. */
__kernel void residual_histogram(const int source_width, const int source_height,
                                 __global const float *depth, __global const float2 *motion,
                                 const Reprojection to_previous, __global int *histogram) {
    const int src_x = get_global_id(0) * RESIDUAL_STRIDE, src_y = get_global_id(1) * RESIDUAL_STRIDE;
    if (src_x >= source_width || src_y >= source_height) return;
    float2 here, there;
    if (!static_residual(src_x, src_y, source_width, depth, motion, to_previous, &here)) return;
    atomic_inc(histogram + residual_bin(here));
    const int near_x = src_x + SCATTER_DISTANCE, near_y = src_y + SCATTER_DISTANCE;
    if (near_x < source_width && near_y < source_height
        && static_residual(near_x, near_y, source_width, depth, motion, to_previous, &there))
        atomic_inc(histogram + RESIDUAL_BINS + residual_bin(here - there));
}

/* Upper bound of the bin below which `share` of a histogram's counts lie; *total is their number. */
inline float quantile(__global const int *histogram, const float share, int *total) {
    *total = 0;
    for (int b = 0; b < RESIDUAL_BINS; ++b) *total += histogram[b];
    int below = 0, bin = 0;
    for (int b = 0; b < RESIDUAL_BINS; ++b) {
        bin = b;
        below += histogram[b];
        if ((float)below >= share * (float)*total) break;
    }
    return as_float((uint)(bin + 1 + RESIDUAL_FIRST_BIN) << 22);
}

/* epsilon from the noise floor: 4 times the lower quartile of the residual, or the median of its change if that is less,
   within [low, high] px. The quartile belongs to static pixels as long as a quarter of the frame is static; where a mover
   fills more, its residual is large but does not change from pixel to pixel, as noise does. */
__kernel void noise_threshold(__global const int *histogram, const float low, const float high,
                              __global float *threshold_squared) {
    int total, pairs;
    const float residual = quantile(histogram, 0.25f, &total);
    const float change = quantile(histogram + RESIDUAL_BINS, 0.5f, &pairs);
    const float noise = pairs ? fmin(residual, change) : residual;
    threshold_squared[0] = total ? clamp(16.0f * noise, low * low, high * high) : low * low;
}

inline bool plausible(const float z, const float z_expected, const float tolerance) {
    return !INVALID_DEPTH(z) && !isinf(z) && fabs(z - z_expected) <= tolerance;
}

/* Depth of the fragment's surface at px_prev in the previous frame, or -1; *nearest is the pixel that has most of it. */
inline float depth_met(const float2 px_prev, const float z_expected, const float tolerance, const int source_width,
                       const int source_height, __global const float *depth_prev, int *nearest) {
    if (!(px_prev.x > -4.0f && px_prev.y > -4.0f && px_prev.x < (float)source_width + 4.0f
          && px_prev.y < (float)source_height + 4.0f))
        return -1.0f;
    const float fx = px_prev.x - 0.5f, fy = px_prev.y - 0.5f;
    const int x0 = (int)floor(fx), y0 = (int)floor(fy);
    const float u = fx - (float)x0, v = fy - (float)y0;
    float sum = 0.0f, weight_sum = 0.0f, heaviest = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = x0 + (tap & 1), tap_y = y0 + (tap >> 1);
        if (!inside(tap_x, tap_y, source_width, source_height)) continue;
        const float z = depth_prev[tap_y * source_width + tap_x];
        if (!plausible(z, z_expected, tolerance)) continue;
        const float weight = bilinear_weight(tap, u, v);
        sum += weight * z;
        weight_sum += weight;
        if (weight > heaviest) { heaviest = weight; *nearest = tap_y * source_width + tap_x; }
    }
    if (weight_sum > 0.0f) return divide(sum, weight_sum);

    const int near_x = (int)floor(px_prev.x), near_y = (int)floor(px_prev.y);
    float found = -1.0f, closest = INFINITY;
    for (int dy = -SEARCH_RADIUS; dy <= SEARCH_RADIUS; ++dy)
        for (int dx = -SEARCH_RADIUS; dx <= SEARCH_RADIUS; ++dx) {
            const int tap_x = near_x + dx, tap_y = near_y + dy;
            if (!inside(tap_x, tap_y, source_width, source_height)) continue;
            const float z = depth_prev[tap_y * source_width + tap_x];
            const float distance = squared_distance(pixel_centre(tap_x, tap_y), px_prev);
            if (distance < closest && plausible(z, z_expected, tolerance)) {
                closest = distance;
                found = z;
                *nearest = tap_y * source_width + tap_x;
            }
        }
    if (found > 0.0f) return found;

    /* A surface that comes straight towards the camera: its depth changes without sideways motion. Believed where all
       four taps agree among themselves, so that x' cannot have slipped off an edge. */
    float low = INFINITY, high = -INFINITY;
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = x0 + (tap & 1), tap_y = y0 + (tap >> 1);
        if (!inside(tap_x, tap_y, source_width, source_height)) return -1.0f;
        const float z = depth_prev[tap_y * source_width + tap_x];
        if (!plausible(z, z_expected, DEPTH_CHANGE_MOST * z_expected)) return -1.0f;
        low = fmin(low, z);
        high = fmax(high, z);
        sum += bilinear_weight(tap, u, v) * z;
    }
    *nearest = (u < 0.5f ? y0 * source_width + x0 : y0 * source_width + x0 + 1) + (v < 0.5f ? 0 : source_width);
    return high - low <= DEPTH_TOLERANCE * low ? sum : -1.0f;
}

/* Algorithm 1. history: k-1 planes of (P_i, 1), or (P_0, 0) where P_i is not known. */
SPARSE __kernel void track_history(const int source_width, const int source_height, const int positions /* k */,
                            const int has_previous,
                            __global const float *depth, __global const float2 *motion,
                            __global const float *depth_prev, __global const uchar *dynamic_prev,
                            __global const float4 *history_prev,
                            const Reprojection to_previous, const Reprojection from_previous,
                            __global const float *threshold_squared,
                            __global uchar *dynamic_mask, __global float4 *history) {
    const int src_x = get_global_id(0), src_y = get_global_id(1);
    if (src_x >= source_width || src_y >= source_height) return;
    const int src = src_y * source_width + src_x, plane = source_width * source_height;
    const float z = depth[src];
    const float3 p0 = unproject(pixel_centre(src_x, src_y), z, to_previous.source_inverse);

    bool is_dynamic = false;
    int known = 0;  /* how many of P_1 ... are known */
    if (has_previous && !INVALID_DEPTH(z) && !isinf(z)) {
        const float2 mv_px = motion[src];
        const float2 px_prev = previous_position(src_x, src_y, mv_px);
        const float3 px_static = static_position(src_x, src_y, z, to_previous);
        const bool usable = isfinite(mv_px.x) && isfinite(mv_px.y);
        const float r2 = squared_distance(px_static.xy, px_prev);
        is_dynamic = !usable || px_static.z < 0.0f || !(r2 <= threshold_squared[0]);
        if (is_dynamic && usable && px_static.z > 0.0f) {
            const float sideways = (fabs(px_prev.x - px_static.x) + fabs(px_prev.y - px_static.y))
                                   * from_previous.source_inverse.x * px_static.z;
            const float tolerance = DEPTH_TOLERANCE * px_static.z + DEPTH_PER_MOTION * sideways;
            int nearest = 0;
            const float z_prev = depth_met(px_prev, px_static.z, tolerance, source_width, source_height, depth_prev,
                                           &nearest);
            if (z_prev > 0.0f) {
                const float3 p1_prev = unproject(px_prev, z_prev, from_previous.source_inverse);
                history[src] = (float4)(move_to_target(p1_prev, from_previous), 1.0f);
                known = 1;
                /* P_i[x] = P'_{i-1}[x'], carried over with the offset between x' and the pixel it is read from. */
                const float3 at_nearest = unproject(pixel_centre(nearest % source_width, nearest / source_width),
                                                    depth_prev[nearest],
                                                    from_previous.source_inverse);
                const float3 offset = p1_prev - at_nearest;
                for (; known < positions - 1; ++known) {
                    float4 older = (float4)(at_nearest, 1.0f);
                    if (dynamic_prev[nearest]) older = history_prev[(known - 1) * plane + nearest];
                    if (older.w == 0.0f) break;
                    history[known * plane + src] = (float4)(move_to_target(older.xyz + offset, from_previous), 1.0f);
                }
            }
        }
    }
    dynamic_mask[src] = is_dynamic;
    for (int k = known; k < positions - 1; ++k) history[k * plane + src] = (float4)(p0, is_dynamic ? 0.0f : 1.0f);
}
