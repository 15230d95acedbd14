/* Flow of shading: from the extrapolated frame into the warped previous one, by least squares (Lucas and Kanade,
   1981), coarse to fine; and the data on flow and trend that the shading correction network judges. Images of level
   l have 1 / 2^l of the sides of the network's frames: 1, a quarter of the display's, is the finest. The flow is
   computed for every second pixel. */

#include "frame.h"
#include "candidates.h"
#include "doubling.h"
#include "sampling.h"

#define FLOW_LEVELS 3
#define FLOW_STEPS 2
#define FLAT 0.0001f      /* squared gradient of encoded color below which nothing moves */
#define LONGEST 2.0f      /* pixels of a step */
#define LITTLE 0.0001f    /* squared change of encoded color */
#define GAIN 4.0f         /* of the network's input */
#define THIRD 0.33333334f
#define PRODUCTS 5
#define REPEATED 7        /* plane of trends: change of brightness in the interval before */
#define DIFFERENCES 4
#define CANDIDATES 16
/* TEXTURE: detail counts as texture fully where the square of its change is a tenth of the squares of both, and not at
   all from half on: TEXTURE - TEXTURE_CHANGE * ratio */
#define TEXTURE 1.25f
#define TEXTURE_CHANGE 2.5f
#define FAINT 0.00001f /* power of detail, summed over 2x2 pixels, below which there is none */

/* Level 1 of both frames: colors of the extrapolated one (3), and the brightness of both (2); and how far the detail of
   brightness, within 2x2 pixels, is the same in both: texture of the surface, which a change of light leaves. */
WIDE __kernel void halve_frames(__constant Frame *restrict frame, __global const float *frames, __global float *colors,
                                __global float *brightness, __global float *texture) {
    const int fine = frame->network_width, width = fine / 2, height = frame->network_height / 2, plane = width * height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), count = width - x, at = y * width + x;
    if (x >= width || y >= height) return;
    Floats of_frames[2][4], mean[2];
    for (int which = 0; which < 2; ++which) {
        Floats sum = 0.0f;
        for (int p = 0; p < 4; ++p) of_frames[which][p] = 0.0f;
        for (int c = 0; c < 3; ++c) {
            Floats part[4];
            load_quads(frames + 4 * (3 * which + c) * plane, fine, x, y, count, part);
            const Floats color = mean_of_quad(part);
            if (which == 0) store_some_floats(color, count, colors + c * plane + at);
            sum += color;
            for (int p = 0; p < 4; ++p) of_frames[which][p] += THIRD * part[p];
        }
        mean[which] = THIRD * sum;
        store_some_floats(mean[which], count, brightness + which * plane + at);
    }
    Floats change = 0.0f, power = FAINT;
    for (int p = 0; p < 4; ++p) {
        const Floats now = of_frames[0][p] - mean[0], before = of_frames[1][p] - mean[1], changed = now - before;
        change += changed * changed;
        power += now * now + before * before;
    }
    store_some_floats(clamp(TEXTURE - TEXTURE_CHANGE * wide_divide(change, power), (Floats)(0.0f), (Floats)(1.0f)),
                      count, texture + at);
}

/* Makes both frames' brightness at `level`, from the level above. */
WIDE __kernel void halve_brightness(__constant Frame *restrict frame, const int level, __global const float *fine,
                                    __global float *brightness) {
    const int width = frame->network_width >> level, height = frame->network_height >> level, plane = width * height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), count = width - x;
    if (x >= width || y >= height) return;
    for (int which = 0; which < 2; ++which)
        store_some_floats(halved(fine + 4 * which * plane, 2 * width, x, y, count), count,
                          brightness + which * plane + y * width + x);
}

/* The flow at `level` to begin with, from that of the level below. */
WIDE __kernel void double_flow(__constant Frame *restrict frame, const int level, __global const float *coarse,
                               __global float *flow) {
    const int width = frame->network_width >> (level + 1), height = frame->network_height >> (level + 1);
    const int x = get_global_id(0) * LANES, y = get_global_id(1), count = width - x, plane = width * height;
    if (x >= width || y >= height) return;
    Taps taps;
    taps_around(x, y, width / 2, height / 2, &taps);
    for (int axis = 0; axis < 2; ++axis)
        store_some_floats(2.0f * interpolate(coarse + axis * (plane / 4), &taps), count,
                          flow + axis * plane + y * width + x);
}

/* The previous frame's brightness at `level`, moved along the flow. */
WIDE __kernel void warp_brightness(__constant Frame *restrict frame, const int level, __global const float *brightness,
                                   __global const float *flow, __global float *warped) {
    const int width = frame->network_width >> level, height = frame->network_height >> level, plane = width * height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), count = width - x;
    if (x >= width || y >= height) return;
    Taps taps;
    taps_around(x, y, width / 2, height / 2, &taps);
    const Floats flow_x = interpolate(flow, &taps), flow_y = interpolate(flow + plane / 4, &taps);
    Sample there;
    find_sample(row_indices(x) + flow_x, (float)y + flow_y, width, height, &there);
    store_some_floats(sampled(brightness + plane, &there), count, warped + y * width + x);
}

/* Sum of both images of which the flow is sought, at columns of a row. */
INLINE Floats both_at(__global const float *now, __global const float *warped, const int width, const Ints column,
                      const int row) {
    const Ints i = row * width + clamp(column, (Ints)(0), (Ints)(width - 1));
    return gather_floats(now, i) + gather_floats(warped, i);
}

/* Makes the means over 2x2 pixels of products of gradients and differences: xx, xy, yy, xr, yr. */
WIDE __kernel void sum_products(__constant Frame *restrict frame, const int level, __global const float *brightness,
                                __global const float *warped, __global float *products) {
    const int width = frame->network_width >> level, height = frame->network_height >> level;
    const int cell_x = get_global_id(0) * LANES, cell_y = get_global_id(1), cells_width = width / 2,
              count = cells_width - cell_x;
    if (cell_x >= cells_width || cell_y >= height / 2) return;
    Floats sums[PRODUCTS];
    for (int k = 0; k < PRODUCTS; ++k) sums[k] = 0.0f;
    for (int part = 0; part < 4; ++part) {
        const Ints column = min(2 * (cell_x + LANE_NUMBERS) + (part & 1), (Ints)(width - 1));
        const int row = 2 * cell_y + (part >> 1), above = max(row - 1, 0), below = min(row + 1, height - 1);
        const Floats x =
            both_at(brightness, warped, width, column + 1, row) - both_at(brightness, warped, width, column - 1, row);
        const Floats y =
            both_at(brightness, warped, width, column, below) - both_at(brightness, warped, width, column, above);
        const Ints i = row * width + column;
        const Floats rest = 4.0f * (gather_floats(warped, i) - gather_floats(brightness, i));
        sums[0] += x * x;
        sums[1] += x * y;
        sums[2] += y * y;
        sums[3] += x * rest;
        sums[4] += y * rest;
    }
    for (int k = 0; k < PRODUCTS; ++k)
        store_some_floats(0.25f * sums[k], count,
                          products + k * (cells_width * (height / 2)) + cell_y * cells_width + cell_x);
}

/* Mean over the 3x3 pixels around, or those of them that there are. */
INLINE Floats mean_around(__global const float *plane, const int width, const int height, const int x, const int y) {
    const int top = max(y - 1, 0), bottom = min(y + 1, height - 1);
    Floats sum = 0.0f, columns = 0.0f;
    for (int dx = -1; dx <= 1; ++dx) {
        const Ints column = x + LANE_NUMBERS + dx, clamped = clamp(column, (Ints)(0), (Ints)(width - 1));
        Floats of_column = 0.0f;
        for (int row = top; row <= bottom; ++row) of_column += gather_floats(plane, row * width + clamped);
        sum += column == clamped ? of_column : (Floats)(0.0f);
        columns += column == clamped ? (Floats)(1.0f) : (Floats)(0.0f);
    }
    return wide_divide(sum, columns * (float)(bottom + 1 - top));
}

/* One step of the flow at `level`, by least squares. */
WIDE __kernel void step_flow(__constant Frame *restrict frame, const int level, __global const float *products,
                             __global float *flow) {
    const int width = frame->network_width >> (level + 1), height = frame->network_height >> (level + 1),
              plane = width * height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), count = width - x, at = y * width + x;
    if (x >= width || y >= height) return;
    Floats mean[PRODUCTS];
    for (int k = 0; k < PRODUCTS; ++k) mean[k] = mean_around(products + k * plane, width, height, x, y);
    const Floats xx = mean[0] + FLAT, xy = mean[1], yy = mean[2] + FLAT, xr = mean[3], yr = mean[4];
    const Floats determinant = xx * yy - xy * xy;
    const Floats step_x = wide_divide(xy * yr - yy * xr, determinant),
                 step_y = wide_divide(xy * xr - xx * yr, determinant);
    const Floats longer = wide_greater(fabs(step_x), fabs(step_y)),
                 excess = wide_greater((1.0f / LONGEST) * longer, (Floats)(1.0f));
    store_some_floats(load_some_floats(count, flow + at) + wide_divide(step_x, excess), count, flow + at);
    store_some_floats(load_some_floats(count, flow + plane + at) + wide_divide(step_y, excess), count,
                      flow + plane + at);
}

/* Makes squared differences at level 2: means over 2x2 pixels of level 1 of the brightness of both frames, in place and
   along the flow; and of its change from the previous interval's, in place and along the flow. */
WIDE __kernel void sum_differences(__constant Frame *restrict frame, __global const float *brightness,
                                   __global const float *warped, __global const float *coarser,
                                   __global const float *flow, __global const float *trends, __global float *products) {
    const int fine = frame->network_width / 2, width = fine / 2, height = frame->network_height / 4,
              plane = width * height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), count = width - x, at = y * width + x;
    if (x >= width || y >= height) return;
    Floats still = 0.0f, along = 0.0f;
    for (int part = 0; part < 4; ++part) {
        const Ints i = (2 * y + (part >> 1)) * fine + min(2 * (x + LANE_NUMBERS) + (part & 1), (Ints)(fine - 1));
        const Floats now = gather_floats(brightness, i);
        const Floats before = gather_floats(brightness + 4 * plane, i) - now, moved = gather_floats(warped, i) - now;
        still += before * before;
        along += moved * moved;
    }
    const Floats changed = load_some_floats(count, coarser + at) - load_some_floats(count, coarser + plane + at);
    const Floats flow_x = load_some_floats(count, flow + at), flow_y = load_some_floats(count, flow + plane + at);
    __global const float *repeated = trends + 4 * REPEATED * plane;
    Sample there;
    find_sample(2.0f * row_indices(x) + 0.5f + flow_x, 2.0f * (float)y + 0.5f + flow_y, fine, 2 * height, &there);
    const Floats again = changed - halved(repeated, fine, x, y, count),
                 again_along = changed - sampled(repeated, &there);
    store_some_floats(0.25f * still, count, products + at);
    store_some_floats(0.25f * along, count, products + plane + at);
    store_some_floats(again * again, count, products + 2 * plane + at);
    store_some_floats(again_along * again_along, count, products + 3 * plane + at);
}

/* Blurs the squared differences. */
WIDE __kernel void blur_differences(__constant Frame *restrict frame, __global const float *products,
                                    __global float *differences) {
    const int width = frame->network_width / 4, height = frame->network_height / 4, plane = width * height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), count = width - x;
    if (x >= width || y >= height) return;
    for (int k = 0; k < DIFFERENCES; ++k)
        store_some_floats(mean_around(products + k * plane, width, height, x, y), count,
                          differences + k * plane + y * width + x);
}

/* Data on trends: 4 x the trend of the last interval (3), 4 x the mean of the trend of the interval before, their
   agreement, and the share of valid samples nearby. */
INLINE void know_trends(__global const float *trends, const int plane, Floats *known) {
    Floats product = 0.0f, square = 0.0f, sum = 0.0f;
    for (int c = 0; c < 3; ++c) {
        const Floats last = load_floats(0, trends + c * plane), earlier = load_floats(0, trends + (3 + c) * plane);
        known[c] = GAIN * last;
        product += last * earlier;
        square += last * last;
        sum += earlier;
    }
    known[3] = GAIN * (THIRD * sum);
    known[4] = clamp(wide_divide(product, square + LITTLE), (Floats)(0.0f), (Floats)(1.0f));
    known[5] = load_floats(0, trends + 6 * plane);
}

/* Planes of the network's input at a quarter of the resolution: the flow (2); the root of the mean squared
   difference in place and along the flow, and their ratio; change of color along the flow until t + alpha (3);
   trends (3) and the mean of the earlier one; difference of brightness; agreement of the trends; their share of
   valid samples; alpha. */
WIDE __kernel void find_candidates(__constant Frame *restrict frame, __global const float *colors,
                                   __global const float *brightness, __global const float *flow,
                                   __global const float *differences, __global const float *trends,
                                   __global float *candidates) {
    const int width = frame->network_width / 2, height = frame->network_height / 2, plane = width * height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), at = y * width + x;
    if (x >= width || y >= height) return;
    Taps taps;
    taps_around(x, y, width / 2, height / 2, &taps);
    const Floats found_x = interpolate(flow, &taps), found_y = interpolate(flow + plane / 4, &taps);
    const Floats still = interpolate(differences, &taps) + LEAST,
                 along = interpolate(differences + plane / 4, &taps) + LEAST;
    Sample there;
    find_sample(row_indices(x) + frame->alpha * found_x, (float)y + frame->alpha * found_y, width, height, &there);
    Floats known[6];
    know_trends(trends + at, plane, known);
    __global float *out = candidates + at;
    store_floats((1.0f / FOUND_UNIT) * found_x, 0, out + FOUND * plane);
    store_floats((1.0f / FOUND_UNIT) * found_y, 0, out + (FOUND + 1) * plane);
    store_floats(GAIN * wide_root(still), 0, out + 2 * plane);
    store_floats(GAIN * wide_root(along), 0, out + 3 * plane);
    store_floats(wide_divide(along, still), 0, out + 4 * plane);
    for (int c = 0; c < 3; ++c) {
        const Floats change = sampled(colors + c * plane, &there) - load_floats(0, colors + c * plane + at);
        store_floats(GAIN * change, 0, out + (5 + c) * plane);
        store_floats(known[c], 0, out + (8 + c) * plane);
    }
    store_floats(known[3], 0, out + 11 * plane);
    store_floats(GAIN * (load_floats(0, brightness + at) - load_floats(0, brightness + plane + at)), 0,
                 out + 12 * plane);
    store_floats(known[4], 0, out + HELD * plane);
    store_floats(known[5], 0, out + 14 * plane);
    store_floats((Floats)(frame->alpha), 0, out + 15 * plane);
}
