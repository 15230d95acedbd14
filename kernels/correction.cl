/* What surrounds the shading correction network (paper: 'Shading Correction Network'): its input at half resolution, and the
   frame that its output makes of the extrapolated one. */

#include "common.h"
#include "wide_rgb.h"

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

/* Of finite numbers: comparisons are cheaper than fmin and fmax, which must sort out NaN. */
inline Floats least(const Floats a, const float b) { return a < b ? a : (Floats)(b); }
inline Floats most(const Floats a, const float b) { return a < b ? (Floats)(b) : a; }

/* ln(x) for x >= 1, to about a unit in the last place: of Cephes (Moshier), without branches. Built-in functions differ
   between runtimes, and not all of them are fast. */
inline Floats log_of(const Floats x) {
    const Ints exponent = (floats_as_ints(x) - 0x3f3504f3) >> 23;  /* of the power of two within sqrt(2) */
    const Floats e = to_floats(exponent), m = ints_as_floats(floats_as_ints(x) - (exponent << 23)) - 1.0f, z = m * m;
    Floats y = 7.0376836292e-2f;
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
inline Floats exp_less_one(const Floats x) {
    const Floats n = floor(x * 1.44269504088896341f + 0.5f);
    const Floats r = x - n * 0.693359375f + n * 2.12194440e-4f;
    Floats y = 1.9875691500e-4f;
    y = y * r + 1.3981999507e-3f;
    y = y * r + 8.3334519073e-3f;
    y = y * r + 4.1665795894e-2f;
    y = y * r + 1.6666665459e-1f;
    y = y * r + 5.0000001201e-1f;
    y = y * r * r + r;
    const Floats power = ints_as_floats((to_ints(n) + 127) << 23);
    return y * power + (power - 1.0f);
}

/* mu-law of colour: 1 at three stops above display white, no upper limit. `law`: mu * exposure / 8, 1 / ln(1 + mu), and
   their reciprocals. */
inline Floats lifted(const Floats c, const float4 law) {
    const Floats positive = c > 0.0f ? c : (Floats)(0.0f);  /* NaN is 0 */
    return 1.0f + law.x * least(positive, COLOR_MAX);
}

inline Floats encode(const Floats c, const float4 law) { return log_of(lifted(c, law)) * law.y; }

inline Floats decode(const Floats e, const float4 law) {
    return least(exp_less_one(least(most(e, 0.0f) * law.w, 88.0f)) * law.z, COLOR_MAX);
}

/* The sum of four encoded numbers: logarithms of two products, which stay below 1e28. */
inline Floats encoded_sum(const Floats a, const Floats b, const Floats c, const Floats d, const float4 law) {
    return (log_of(lifted(a, law) * lifted(b, law)) + log_of(lifted(c, law) * lifted(d, law))) * law.y;
}

/* Means over 2x2 pixels, encoded, of an image: three planes of the network's input. */
inline void store_colors(const bool inner, const int *first, const Ints *at, const float4 law, __global const half *color,
                         const int plane_size, __global float *planes) {
    WideRgb c[4];
    for (int tap = 0; tap < 4; ++tap) c[tap] = inner ? load_rgb_alternate(color + 4 * first[tap]) : gather_rgb(color, at[tap]);
    store_floats(0.25f * encoded_sum(c[0].r, c[1].r, c[2].r, c[3].r, law), 0, planes);
    store_floats(0.25f * encoded_sum(c[0].g, c[1].g, c[2].g, c[3].g, law), 0, planes + plane_size);
    store_floats(0.25f * encoded_sum(c[0].b, c[1].b, c[2].b, c[3].b, law), 0, planes + 2 * plane_size);
}

/* Planes of the network's input: means over 2x2 pixels, the image's border repeated. */
WIDE __kernel void network_input(const int target_width, const int target_height, const int network_width,
                                 const int network_height, const float4 law, __global const half *color,
                                 __global const half *warped_previous, __global const float *depth,
                                 __global const half *input_mask, __global const float *median_depth,
                                 __global float *frames) {
    const int net_x = get_global_id(0) * LANES, net_y = get_global_id(1);
    if (net_x >= network_width || net_y >= network_height) return;
    const bool inner = 2 * (net_x + LANES) < target_width;
    int first[4];
    Ints at[4];
    Floats inverse = 0.0f, mask = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int row = min(2 * net_y + (tap >> 1), target_height - 1) * target_width;
        first[tap] = row + 2 * net_x + (tap & 1);
        at[tap] = row + min(2 * (net_x + LANE_NUMBERS) + (tap & 1), (Ints)(target_width - 1));
        const Floats z = inner ? load_floats_alternate(depth + first[tap]) : gather_floats(depth, at[tap]);
        inverse += least(wide_divide((Floats)(*median_depth), z), MAX_INVERSE_DEPTH);
        mask += inner ? load_halfs_alternate(input_mask + first[tap]) : gather_halfs(input_mask, at[tap]);
    }
    const int net = net_y * network_width + net_x, plane_size = network_width * network_height;
    store_colors(inner, first, at, law, color, plane_size, frames + net);
    store_colors(inner, first, at, law, warped_previous, plane_size, frames + 3 * plane_size + net);
    store_floats(0.25f * inverse, 0, frames + 6 * plane_size + net);
    store_floats(0.25f * mask, 0, frames + 7 * plane_size + net);
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

/* refined: the network's image, the detail of the extrapolated one kept as it says; out_color: that within the focus mask,
   the extrapolated colour's own bits where the mask is 0. Output that is not finite counts as no mask. `refined` is made only
   for whoever asks for it: else a run of pixels without mask is a copy. */
WIDE __kernel void correct(const int target_width, const int target_height, const int network_width, const int network_height,
                           const float4 law, const int within_mask, const int with_refined,
                           __global const half *color, __global const float *frames, __global const float *correction,
                           __global half *refined, __global half *focus_mask, __global half *out_color) {
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
    const Floats mask = (usable & (m >= LEAST_MASK)) ? least(m, 1.0f) : (Floats)(0.0f);
    store_some_halfs(mask, count, focus_mask + i);
    const WideRgb made = {decode(e_r, law), decode(e_g, law), decode(e_b, law)};
    if (with_refined) store_where(usable, made, count, color + 4 * i, refined + 4 * i);
    const Floats whole = usable ? (Floats)(1.0f) : (Floats)(0.0f), share = within_mask ? mask : whole, rest = 1.0f - share;
    const WideRgb mixed = {c.r * rest + made.r * share, c.g * rest + made.g * share, c.b * rest + made.b * share};
    store_where(share > 0.0f, mixed, count, color + 4 * i, out_color + 4 * i);
}
