/* What surrounds the shading correction network (paper: 'Shading Correction Network'): its input at half resolution, and the
   frame that its output makes of the extrapolated one. */

#include "common.h"
#include "rgb.h"

#define BIN_BITS 16       /* dropped from a depth: bins are 1/128 of a power of two wide */
#define BINS 32768
#define STRIP 16          /* rows per work-item of depth_histogram: equal bins in a run cost one atomic */
#define SCANNERS 64       /* work-items of find_median */
#define MAX_INVERSE_DEPTH 8.0f
#define LEAST_MASK 0.03125f  /* a smaller focus mask is 0 */

/* How often each bin of finite depth occurs. */
__kernel void depth_histogram(const int target_width, const int target_height, __global const float *depth,
                              __global uint *histogram) {
    const int dst_x = get_global_id(0), first = get_global_id(1) * STRIP;
    if (dst_x >= target_width) return;
    uint bin = 0, run = 0;
    for (int dst_y = first; dst_y < min(first + STRIP, target_height); ++dst_y) {
        const float z = depth[dst_y * target_width + dst_x];
        if (INVALID_DEPTH(z) || isinf(z)) continue;
        const uint here = as_uint(z) >> BIN_BITS;
        if (run && here != bin) {
            atomic_add(histogram + bin, run);
            run = 0;
        }
        bin = here;
        ++run;
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

/* ln(x) for x >= 1, to about a unit in the last place: of Cephes (Moshier), without branches. Built-in functions differ
   between runtimes, and not all of them are fast. */
inline float log_of(const float x) {
    const int exponent = (as_int(x) - 0x3f3504f3) >> 23;  /* of the power of two within sqrt(2) */
    const float e = (float)exponent, m = as_float(as_int(x) - (exponent << 23)) - 1.0f, z = m * m;
    float y = 7.0376836292e-2f;
    y = y * m - 1.1514610310e-1f;
    y = y * m + 1.1676998740e-1f;
    y = y * m - 1.2420140846e-1f;
    y = y * m + 1.4249322787e-1f;
    y = y * m - 1.6668057665e-1f;
    y = y * m + 2.0000714765e-1f;
    y = y * m - 2.4999993993e-1f;
    y = y * m + 3.3333331174e-1f;
    y = y * m * z - 2.12194440e-4f * e - 0.5f * z;
    return m + y + 0.693359375f * e;
}

/* exp(x) - 1 for x from 0 to 88, likewise. */
inline float exp_less_one(const float x) {
    const float n = floor(x * 1.44269504088896341f + 0.5f);
    const float r = x - n * 0.693359375f + n * 2.12194440e-4f;
    float y = 1.9875691500e-4f;
    y = y * r + 1.3981999507e-3f;
    y = y * r + 8.3334519073e-3f;
    y = y * r + 4.1665795894e-2f;
    y = y * r + 1.6666665459e-1f;
    y = y * r + 5.0000001201e-1f;
    y = y * r * r + r;
    const float power = as_float(((int)n + 127) << 23);
    return y * power + (power - 1.0f);
}

/* mu-law of colour: 1 at three stops above display white, no upper limit. `law`: mu * exposure / 8, 1 / ln(1 + mu), and
   their reciprocals. */
inline float encode(const float c, const float4 law) { return log_of(1.0f + law.x * most(c, 0.0f)) * law.y; }

inline float decode(const float e, const float4 law) {
    return least(exp_less_one(least(most(e, 0.0f) * law.w, 88.0f)) * law.z, COLOR_MAX);
}

/* Planes of the network's input: means over 2x2 pixels, the image's border repeated. */
__kernel void network_input(const int target_width, const int target_height, const int network_width,
                            const int network_height,
                            const float4 law, __global const uint2 *color /* half x4 */,
                            __global const uint2 *warped_previous /* half x4 */, __global const float *depth,
                            __global const half *input_mask, __global const float *median_depth, __global float *frames) {
    const int net_x = get_global_id(0), net_y = get_global_id(1);
    if (net_x >= network_width || net_y >= network_height) return;
    const float median = *median_depth;
    Rgb now = {0.0f, 0.0f, 0.0f}, before = now;
    float inverse = 0.0f, mask = 0.0f;
#pragma unroll
    for (int tap = 0; tap < 4; ++tap) {
        const int dst_x = min(2 * net_x + (tap & 1), target_width - 1);
        const int dst_y = min(2 * net_y + (tap >> 1), target_height - 1), dst = dst_y * target_width + dst_x;
        const Rgb a = load_rgb(color, dst), b = load_rgb(warped_previous, dst);
        now.r += encode(a.r, law);
        now.g += encode(a.g, law);
        now.b += encode(a.b, law);
        before.r += encode(b.r, law);
        before.g += encode(b.g, law);
        before.b += encode(b.b, law);
        inverse += least(divide(median, depth[dst]), MAX_INVERSE_DEPTH);
        mask += vload_half(dst, input_mask);
    }
    const int net = net_y * network_width + net_x, plane = network_width * network_height;
    frames[net] = 0.25f * now.r;
    frames[net + plane] = 0.25f * now.g;
    frames[net + 2 * plane] = 0.25f * now.b;
    frames[net + 3 * plane] = 0.25f * before.r;
    frames[net + 4 * plane] = 0.25f * before.g;
    frames[net + 5 * plane] = 0.25f * before.b;
    frames[net + 6 * plane] = 0.25f * inverse;
    frames[net + 7 * plane] = 0.25f * mask;
}

/* The four taps of bilinear interpolation of an image at half resolution. */
typedef struct { int a, b, c, d; float wa, wb, wc, wd; } Taps;

inline Taps taps_of(const int x, const int y, const int width, const int height) {
    const int x0 = (x - 1) >> 1, y0 = (y - 1) >> 1;
    const int left = max(x0, 0), right = min(x0 + 1, width - 1);
    const int top = max(y0, 0) * width, bottom = min(y0 + 1, height - 1) * width;
    const float u = (x & 1) ? 0.25f : 0.75f, v = (y & 1) ? 0.25f : 0.75f;
    const Taps taps = {top + left, top + right, bottom + left, bottom + right,
                       (1.0f - u) * (1.0f - v), u * (1.0f - v), (1.0f - u) * v, u * v};
    return taps;
}

inline float interpolate(__global const float *image, const Taps t) {
    return t.wa * image[t.a] + t.wb * image[t.b] + t.wc * image[t.c] + t.wd * image[t.d];
}

/* refined: the network's image, the detail of the extrapolated one kept as it says; out_color: that within the focus mask,
   the extrapolated colour's own bits where the mask is 0. Output that is not finite counts as no mask. */
__kernel void correct(const int target_width, const int target_height, const int network_width, const int network_height,
                      const float4 law, const int within_mask, __global const uint2 *color /* half x4 */,
                      __global const float *frames, __global const float *correction,
                      __global uint2 *refined /* half x4 */, __global half *focus_mask,
                      __global uint2 *out_color /* half x4 */) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= target_width || y >= target_height) return;
    const int i = y * target_width + x, plane = network_width * network_height;
    const Taps taps = taps_of(x, y, network_width, network_height);
    const Rgb c = load_rgb(color, i);
    const float keep = interpolate(correction + 3 * plane, taps);
    const float low_r = interpolate(frames, taps);
    const float low_g = interpolate(frames + plane, taps);
    const float low_b = interpolate(frames + 2 * plane, taps);
    const float e_r = low_r + interpolate(correction, taps) + keep * (encode(c.r, law) - low_r);
    const float e_g = low_g + interpolate(correction + plane, taps) + keep * (encode(c.g, law) - low_g);
    const float e_b = low_b + interpolate(correction + 2 * plane, taps) + keep * (encode(c.b, law) - low_b);
    const float m = interpolate(correction + 4 * plane, taps);
    const bool usable = isfinite(e_r + e_g + e_b + m);
    const float mask = usable && m >= LEAST_MASK ? least(m, 1.0f) : 0.0f;
    vstore_half_rte(mask, i, focus_mask);
    /* Stores of their own per case: see shading.cl. */
    const float r = decode(e_r, law), g = decode(e_g, law), b = decode(e_b, law);
    if (usable) {
        vstore_half4_rte((float4)(r, g, b, 0.0f), i, (__global half *)refined);
    } else {
        refined[i] = color[i];
    }
    const float share = within_mask ? mask : usable ? 1.0f : 0.0f;
    if (share > 0.0f) {
        const float rest = 1.0f - share;
        vstore_half4_rte((float4)(c.r * rest + r * share, c.g * rest + g * share, c.b * rest + b * share, 0.0f), i,
                         (__global half *)out_color);
    } else {
        out_color[i] = color[i];
    }
}
