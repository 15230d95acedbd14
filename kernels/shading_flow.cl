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

/* Work-groups have TILE_WIDTH x TILE_HEIGHT work-items, as many as pixels of the smaller image that they make. They do
   their work in chunks of LANES pixels of a row, with what is around in local memory. */
#define TILE_WIDTH 16
#define TILE_HEIGHT 8
#define ITEMS 128 /* their product */
#define CHUNKS(pixels) (((pixels) + LANES - 1) / LANES)
#define TILE __attribute__((reqd_work_group_size(TILE_WIDTH, TILE_HEIGHT, 1)))
#define ITEM ((int)(get_local_id(1) * TILE_WIDTH + get_local_id(0)))
#define TILE_X ((int)(get_group_id(0) * TILE_WIDTH))
#define TILE_Y ((int)(get_group_id(1) * TILE_HEIGHT))

/* Level 1 of both frames, LANES pixels from (x, y) on: colors of the extrapolated one (3), and the brightness of both
   (2); and how far the detail of brightness, within 2x2 pixels, is the same in both: texture of the surface, which a
   change of light leaves. */
INLINE void halve_frames(const int fine, const int height, const int x, const int y, __global const float *frames,
                         __global float *colors, __global float *brightness, __global float *texture) {
    const int width = fine / 2, plane = width * height, count = width - x, at = y * width + x;
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

/* Both frames' brightness in a tile's part of an image of `width` by `height`, from the level above. */
INLINE void halve_brightness(const int width, const int height, const int part, __global const float *fine,
                             __global float *brightness) {
    const int chunks = CHUNKS(TILE_WIDTH / part), plane = width * height;
    for (int i = ITEM; i < chunks * (TILE_HEIGHT / part); i += ITEMS) {
        const int x = TILE_X / part + LANES * (i % chunks), y = TILE_Y / part + i / chunks;
        const int count = min(width, (TILE_X + TILE_WIDTH) / part) - x;
        if (count <= 0 || y >= height) continue;
        for (int which = 0; which < 2; ++which)
            store_some_floats(halved(fine + 4 * which * plane, 2 * width, x, y, count), count,
                              brightness + which * plane + y * width + x);
    }
}

/* Makes levels 1 to 3 of both frames' brightness, and of level 1 colors and texture. Nothing of a tile's levels is made
   of anything else. */
WIDE TILE __kernel void make_levels(__constant Frame *restrict frame, __global const float *frames,
                                    __global float *colors, __global float *texture, __global float *brightness1,
                                    __global float *brightness2, __global float *brightness3) {
    const int width = frame->network_width / 2, height = frame->network_height / 2;
    for (int i = ITEM; i < TILE_WIDTH / LANES * TILE_HEIGHT; i += ITEMS) {
        const int x = TILE_X + LANES * (i % (TILE_WIDTH / LANES)), y = TILE_Y + i / (TILE_WIDTH / LANES);
        if (x < width && y < height)
            halve_frames(2 * width, height, x, y, frames, colors, brightness1, texture);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    halve_brightness(width / 2, height / 2, 2, brightness1, brightness2);
    barrier(CLK_GLOBAL_MEM_FENCE);
    halve_brightness(width / 4, height / 4, 4, brightness2, brightness3);
}

/* The flow of a tile's pixels and of those around them in local memory, the image's border repeated. */
#define AROUND 2
#define FLOW_ROWS (TILE_HEIGHT + 2 * AROUND)
#define FLOW_CHUNKS CHUNKS(TILE_WIDTH + 2 * AROUND)
#define FLOW_PITCH (LANES * FLOW_CHUNKS)
#define FLOW_PLANE (FLOW_ROWS * FLOW_PITCH)
#define FLOW_FLOATS (2 * FLOW_PLANE + 2 * LANES) /* LANES before and after are read, and not used */

/* Loads a flow of an image of `width` by `height`; `doubles`: it is that of the level below. */
INLINE void load_flow(__global const float *flow, const bool doubles, const int width, const int height,
                      __local float *near) {
    const int plane = width * height;
    for (int i = ITEM; i < FLOW_ROWS * FLOW_CHUNKS; i += ITEMS) {
        const int row = i / FLOW_CHUNKS, chunk = i % FLOW_CHUNKS, y = clamp(TILE_Y - AROUND + row, 0, height - 1);
        const Ints x = clamp(TILE_X - AROUND + LANES * chunk + LANE_NUMBERS, (Ints)(0), (Ints)(width - 1));
        __local float *out = near + LANES + row * FLOW_PITCH + LANES * chunk;
        Taps taps;
        taps_of(x, y, width / 2, height / 2, &taps);
        for (int axis = 0; axis < 2; ++axis) {
            const Floats value = doubles ? 2.0f * interpolate(flow + axis * (plane / 4), &taps)
                                         : gather_floats(flow + axis * plane + y * width, x);
            store_floats(value, 0, out + axis * FLOW_PLANE);
        }
    }
}

/* A flow where images have two pixels for one of it: in row y, LANES of the left ones or of the `right` ones, of pixels
   from `column` of the tile on. */
INLINE Floats flow_at(__local const float *near, const int column, const bool right, const int y) {
    __local const float *top = near + LANES + (((y - 1) >> 1) - TILE_Y + AROUND) * FLOW_PITCH + column + AROUND;
    top += right ? 0 : -1;
    const float u = right ? 0.25f : 0.75f, v = (y & 1) ? 0.25f : 0.75f;
    return (1.0f - u) * (1.0f - v) * load_floats(0, top) + u * (1.0f - v) * load_floats(0, top + 1)
           + (1.0f - u) * v * load_floats(0, top + FLOW_PITCH) + u * v * load_floats(0, top + FLOW_PITCH + 1);
}

/* The previous frame's brightness moved along the flow: an image of `width` by `height`, where `flow_at` is. */
INLINE Floats warped_at(__global const float *before, __local const float *near, const int width, const int height,
                        const int column, const bool right, const int y) {
    const Ints x = 2 * (TILE_X + column + LANE_NUMBERS) + (right ? 1 : 0);
    Sample there;
    find_sample(to_floats(x) + flow_at(near, column, right, y), (float)y + flow_at(near + FLOW_PLANE, column, right, y),
                width, height, &there);
    return sampled(before, &there);
}

/* Sums of a tile and of the pixels around it, planes in local memory. */
#define SUM_ROWS (TILE_HEIGHT + 2)
#define SUM_CHUNKS CHUNKS(TILE_WIDTH + 2)
#define SUM_PITCH (LANES * SUM_CHUNKS)
#define SUM_PLANE (SUM_ROWS * SUM_PITCH)

/* Mean over the 3x3 pixels around those from (x, y) of the tile on, or over those of them that there are in the image. */
INLINE Floats mean_around(__local const float *sums, const int width, const int height, const int x, const int y) {
    const int first = max(TILE_Y + y - 1, 0) - TILE_Y + 1, last = min(TILE_Y + y + 1, height - 1) - TILE_Y + 1;
    Floats sum = 0.0f, columns = 0.0f;
    for (int dx = -1; dx <= 1; ++dx) {
        const Ints column = TILE_X + x + LANE_NUMBERS + dx, there = (column >= 0) & (column < width);
        Floats of_column = 0.0f;
        for (int row = first; row <= last; ++row) of_column += load_floats(0, sums + row * SUM_PITCH + x + 1 + dx);
        sum += there ? of_column : (Floats)(0.0f);
        columns += there ? (Floats)(1.0f) : (Floats)(0.0f);
    }
    return wide_divide(sum, columns * (float)(last + 1 - first));
}

/* Left and right pixels of an image near a tile, as they lie in local memory: rows from the third above it on, which
   are three below the first of these pixels; columns as those of the flow. */
#define PIXEL_ROWS (2 * TILE_HEIGHT + 6)
#define PIXEL_ROW (2 * FLOW_PITCH)
#define ABOVE 3

/* One step of the flow at `level`, by least squares, from the flow `begun`, or, if it `doubles`, from that of the level
   below. */
WIDE TILE __kernel void step_flow(__constant Frame *restrict frame, const int level, const int doubles,
                                  __global const float *restrict brightness, __global const float *restrict begun,
                                  __global float *restrict flow) {
    /* both: the sum of both images of which the flow is sought; rest: four times their difference */
    __local float near[FLOW_FLOATS], both[PIXEL_ROWS * PIXEL_ROW + 2 * LANES], rest[PIXEL_ROWS * PIXEL_ROW];
    __local float products[PRODUCTS * SUM_PLANE];
    const int fine = frame->network_width >> level, fine_height = frame->network_height >> level;
    const int width = fine / 2, height = fine_height / 2, plane = width * height;
    load_flow(begun, doubles, width, height, near);
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM; i < PIXEL_ROWS * FLOW_CHUNKS; i += ITEMS) {
        const int row = i / FLOW_CHUNKS, column = LANES * (i % FLOW_CHUNKS) - AROUND, y = 2 * TILE_Y - ABOVE + row;
        if (y < 0 || y >= fine_height) continue;
        const Ints x = 2 * clamp(TILE_X + column + LANE_NUMBERS, (Ints)(0), (Ints)(width - 1));
        for (int right = 0; right < 2; ++right) {
            const int at = row * PIXEL_ROW + right * FLOW_PITCH + column + AROUND;
            const Floats now = gather_floats(brightness + y * fine + right, x);
            const Floats before = warped_at(brightness + 4 * plane, near, fine, fine_height, column, right, y);
            store_floats(now + before, 0, both + LANES + at);
            store_floats(4.0f * (before - now), 0, rest + at);
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    /* Means over 2x2 pixels of products of gradients and differences: xx, xy, yy, xr, yr. */
    for (int i = ITEM; i < SUM_ROWS * SUM_CHUNKS; i += ITEMS) {
        const int row = i / SUM_CHUNKS, column = LANES * (i % SUM_CHUNKS) - 1;
        if (TILE_Y + row - 1 < 0 || TILE_Y + row - 1 >= height) continue;
        const Ints x = TILE_X + column + LANE_NUMBERS;
        Floats sums[PRODUCTS];
        for (int k = 0; k < PRODUCTS; ++k) sums[k] = 0.0f;
        for (int part = 0; part < 4; ++part) {
            const int right = part & 1, y = 2 * (TILE_Y + row - 1) + (part >> 1);
            const int at = (y - 2 * TILE_Y + ABOVE) * PIXEL_ROW + right * FLOW_PITCH + column + AROUND;
            __local const float *here = both + LANES + at;
            Floats before = load_floats(0, here + (right ? -FLOW_PITCH : FLOW_PITCH - 1));
            Floats after = load_floats(0, here + (right ? 1 - FLOW_PITCH : FLOW_PITCH));
            if (right) {
                after = x == width - 1 ? load_floats(0, here) : after;
            } else {
                before = x == 0 ? load_floats(0, here) : before;
            }
            const Floats above = load_floats(0, here - (y > 0 ? PIXEL_ROW : 0));
            const Floats below = load_floats(0, here + (y < fine_height - 1 ? PIXEL_ROW : 0));
            const Floats gradient_x = after - before, gradient_y = below - above, change = load_floats(0, rest + at);
            sums[0] += gradient_x * gradient_x;
            sums[1] += gradient_x * gradient_y;
            sums[2] += gradient_y * gradient_y;
            sums[3] += gradient_x * change;
            sums[4] += gradient_y * change;
        }
        for (int k = 0; k < PRODUCTS; ++k)
            store_floats(0.25f * sums[k], 0, products + k * SUM_PLANE + row * SUM_PITCH + column + 1);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM; i < TILE_WIDTH / LANES * TILE_HEIGHT; i += ITEMS) {
        const int row = i / (TILE_WIDTH / LANES), column = LANES * (i % (TILE_WIDTH / LANES));
        const int count = width - TILE_X - column, at = (TILE_Y + row) * width + TILE_X + column;
        if (count <= 0 || TILE_Y + row >= height) continue;
        Floats mean[PRODUCTS];
        for (int k = 0; k < PRODUCTS; ++k) mean[k] = mean_around(products + k * SUM_PLANE, width, height, column, row);
        const Floats xx = mean[0] + FLAT, xy = mean[1], yy = mean[2] + FLAT, xr = mean[3], yr = mean[4];
        const Floats determinant = xx * yy - xy * xy;
        const Floats step_x = wide_divide(xy * yr - yy * xr, determinant),
                     step_y = wide_divide(xy * xr - xx * yr, determinant);
        const Floats longer = wide_greater(fabs(step_x), fabs(step_y)),
                     excess = wide_greater((1.0f / LONGEST) * longer, (Floats)(1.0f));
        __local const float *here = near + LANES + (row + AROUND) * FLOW_PITCH + column + AROUND;
        store_some_floats(load_floats(0, here) + wide_divide(step_x, excess), count, flow + at);
        store_some_floats(load_floats(0, here + FLOW_PLANE) + wide_divide(step_y, excess), count, flow + plane + at);
    }
}

/* Makes the mean squared differences nearby, at level 2: means over 2x2 pixels of level 1 of the brightness of both
   frames, in place and along the flow; and of its change from the previous interval's, in place and along the flow. */
WIDE TILE __kernel void find_differences(__constant Frame *restrict frame, __global const float *restrict brightness,
                                         __global const float *restrict coarser, __global const float *restrict flow,
                                         __global const float *restrict trends, __global float *restrict differences) {
    __local float near[FLOW_FLOATS], squares[DIFFERENCES * SUM_PLANE];
    const int fine = frame->network_width / 2, fine_height = frame->network_height / 2;
    const int width = fine / 2, height = fine_height / 2, plane = width * height;
    load_flow(flow, false, width, height, near);
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM; i < SUM_ROWS * SUM_CHUNKS; i += ITEMS) {
        const int row = i / SUM_CHUNKS, column = LANES * (i % SUM_CHUNKS) - 1, y = TILE_Y + row - 1;
        if (y < 0 || y >= height) continue;
        const Ints x = clamp(TILE_X + column + LANE_NUMBERS, (Ints)(0), (Ints)(width - 1)), at = y * width + x;
        Floats still = 0.0f, along = 0.0f, repeated[4];
        for (int part = 0; part < 4; ++part) {
            const int right = part & 1, fine_y = 2 * y + (part >> 1);
            const Ints fine_at = fine_y * fine + 2 * x + right;
            const Floats now = gather_floats(brightness, fine_at);
            const Floats before = gather_floats(brightness + 4 * plane, fine_at) - now;
            const Floats moved = warped_at(brightness + 4 * plane, near, fine, fine_height, column, right, fine_y) - now;
            still += before * before;
            along += moved * moved;
            repeated[part] = gather_floats(trends + 4 * REPEATED * plane, fine_at);
        }
        __local const float *here = near + LANES + (row - 1 + AROUND) * FLOW_PITCH + column + AROUND;
        const Floats flow_x = load_floats(0, here), flow_y = load_floats(0, here + FLOW_PLANE);
        const Floats changed = gather_floats(coarser, at) - gather_floats(coarser + plane, at);
        Sample there;
        find_sample(2.0f * to_floats(x) + 0.5f + flow_x, 2.0f * (float)y + 0.5f + flow_y, fine, fine_height, &there);
        const Floats again = changed - mean_of_quad(repeated),
                     again_along = changed - sampled(trends + 4 * REPEATED * plane, &there);
        __local float *out = squares + row * SUM_PITCH + column + 1;
        store_floats(0.25f * still, 0, out);
        store_floats(0.25f * along, 0, out + SUM_PLANE);
        store_floats(again * again, 0, out + 2 * SUM_PLANE);
        store_floats(again_along * again_along, 0, out + 3 * SUM_PLANE);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM; i < TILE_WIDTH / LANES * TILE_HEIGHT; i += ITEMS) {
        const int row = i / (TILE_WIDTH / LANES), column = LANES * (i % (TILE_WIDTH / LANES));
        const int count = width - TILE_X - column, at = (TILE_Y + row) * width + TILE_X + column;
        if (count <= 0 || TILE_Y + row >= height) continue;
        for (int k = 0; k < DIFFERENCES; ++k)
            store_some_floats(mean_around(squares + k * SUM_PLANE, width, height, column, row), count,
                              differences + k * plane + at);
    }
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
