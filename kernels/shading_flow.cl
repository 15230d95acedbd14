/* Flow of shading: from the extrapolated frame into the warped previous one, by least squares (Lucas and Kanade,
   1981), coarse to fine; the data on flow and trend that the shading correction network judges; and where the flow
   explains the last interval. Images of level l have 1 / 2^l of the sides of the network's frames: the flow is sought
   from level 1 on, a quarter of the display's, for every second pixel. */

#include "frame.h"
#include "candidates.h"
#include "doubling.h"
#include "sampling.h"

/* What set the thresholds: docs/deviations.md, "Texture stays whatever the network says" and "What the image flow
   explains follows it". */
#define FLOW_LEVELS 3
#define FLOW_STEPS 2
#define FLAT 0.0001f      /* squared gradient of encoded color below which nothing moves */
#define LONGEST_STEP 2.0f      /* pixels of a step */
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
#define EXPLAINED 0.5f /* the flow is followed if it leaves less than this part of the squared difference, ... */
#define UNLIKE 0.0003f /* ... which must be more than this, ... */
#define LONGEST_FLOW 48 /* ... if each way it is shorter than this part of the width, ... */
#define FLOW_VARIES 2.0f /* ... varies by less than this each way between neighbors, in pixels of level 0, ... */
#define BENT 0.1f /* ... where inverse depth bends by less than this part between three pixels */
#define INVERSE_DEPTH 6 /* plane of the network's frames */

/* Level 1 of both frames: colors of the extrapolated one (3), and the brightness of both (2), this of level 0, too; and
   how far the detail of brightness, within 2x2 pixels, is the same in both: texture of the surface, which a change of
   light leaves. */
WIDE __kernel void halve_frames(__constant Frame *restrict frame, __global const float *frames, __global float *colors,
                                __global float *brightness0, __global float *brightness, __global float *texture) {
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
        for (int row = 0; row < 2; ++row)
            store_some_xy(of_frames[which][2 * row], of_frames[which][2 * row + 1], count,
                          (__global float2 *)(brightness0 + 4 * which * plane + (2 * y + row) * fine + 2 * x));
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

/* Makes levels 2 and 3 of both frames' brightness. */
WIDE __kernel void halve_brightness(__constant Frame *restrict frame, __global const float *brightness1,
                                    __global float *brightness2, __global float *brightness3) {
    const int width = frame->network_width / 8, height = frame->network_height / 8, plane = width * height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), count = width - x;
    if (x >= width || y >= height) return;
    for (int which = 0; which < 2; ++which) {
        __global float *made = brightness2 + 4 * which * plane;
        for (int part = 0; part < 4; ++part) {
            const int fine_x = 2 * x + (part & 1) * LANES, fine_y = 2 * y + (part >> 1), left = 2 * width - fine_x;
            if (left > 0)
                store_some_floats(halved(brightness1 + 16 * which * plane, 4 * width, fine_x, fine_y, left), left,
                                  made + fine_y * 2 * width + fine_x);
        }
        store_some_floats(halved(made, 2 * width, x, y, count), count, brightness3 + which * plane + y * width + x);
    }
}

/* Work-groups have as many work-items as pixels of the flow, of a tile, which they work on in local memory, in chunks
   of LANES pixels of a row. */
#define TILE_WIDTH 16
#define TILE_HEIGHT 8
#define ITEMS 128 /* their product */
#define TILED __attribute__((reqd_work_group_size(TILE_WIDTH, TILE_HEIGHT, 1)))
#define ITEM ((int)(get_local_id(1) * TILE_WIDTH + get_local_id(0)))
#define TILE_X ((int)(get_group_id(0) * TILE_WIDTH))
#define TILE_Y ((int)(get_group_id(1) * TILE_HEIGHT))
#define CHUNKS(pixels) (((pixels) + LANES - 1) / LANES)

/* The flow of a tile and AROUND it, in both planes one row after another, the image's border repeated. */
#define AROUND 3
#define FLOW_ROWS (TILE_HEIGHT + 2 * AROUND)
#define FLOW_CHUNKS CHUNKS(TILE_WIDTH + 2 * AROUND)
#define FLOW_PITCH (LANES * FLOW_CHUNKS)
#define FLOW_PLANE (FLOW_ROWS * FLOW_PITCH)

/* Pixels of an image with two of them for one of the flow, each way: of a tile and PIXELS_AROUND it. */
#define PIXELS_AROUND 4
#define PIXEL_ROWS (2 * TILE_HEIGHT + 2 * PIXELS_AROUND)
#define PIXEL_PITCH (2 * TILE_WIDTH + 2 * PIXELS_AROUND)
#define PIXEL_CHUNKS (PIXEL_PITCH / LANES)
#define PIXELS (PIXEL_ROWS * PIXEL_PITCH + 2 * LANES) /* those after the last are read, and not used */

/* Sums of a tile and of the pixels next to it. */
#define SUM_ROWS (TILE_HEIGHT + 2)
#define SUM_CHUNKS CHUNKS(TILE_WIDTH + 2)
#define SUM_PITCH (LANES * SUM_CHUNKS)
#define SUM_PLANE (SUM_ROWS * SUM_PITCH)

/* Loads the flow of an image of `width` by `height`; `doubles`: from that of the level below. */
INLINE void load_flow(__global const float *flow, const bool doubles, const int width, const int height,
                      __local float *near) {
    const int plane = width * height;
    for (int i = ITEM; i < FLOW_ROWS * FLOW_CHUNKS; i += ITEMS) {
        const int row = i / FLOW_CHUNKS, column = LANES * (i % FLOW_CHUNKS);
        const int y = clamp(TILE_Y - AROUND + row, 0, height - 1);
        const Ints x = clamp(TILE_X - AROUND + column + LANE_NUMBERS, (Ints)(0), (Ints)(width - 1));
        Taps taps;
        taps_of(x, y, width / 2, height / 2, &taps);
        for (int axis = 0; axis < 2; ++axis) {
            const Floats value = doubles ? 2.0f * interpolate(flow + axis * (plane / 4), &taps)
                                         : gather_floats(flow + axis * plane + y * width, x);
            store_floats(value, 0, near + axis * FLOW_PLANE + row * FLOW_PITCH + column);
        }
    }
}

/* One plane of the flow, interpolated at pixels from (x, y) on; x is even with several lanes. */
INLINE Floats flow_at(__local const float *near, const int x, const int y) {
    __local const float *top =
        near + (((y - 1) >> 1) - TILE_Y + AROUND) * FLOW_PITCH + ((x - 1) >> 1) - TILE_X + AROUND;
    __local const float *bottom = top + FLOW_PITCH;
    const Floats a = load_left_taps(top), b = load_right_taps(top);
    const Floats c = load_left_taps(bottom), d = load_right_taps(bottom);
    const Floats u = ((x + LANE_NUMBERS) & 1) == 1 ? (Floats)(0.25f) : (Floats)(0.75f);
    const float v = (y & 1) ? 0.25f : 0.75f;
    return (1.0f - u) * (1.0f - v) * a + u * (1.0f - v) * b + (1.0f - u) * v * c + u * v * d;
}

/* Brightness of an image of `width` by `height` at pixels from (x, y) on: in the extrapolated frame and, moved along
   the flow, in the previous one. */
INLINE void load_both(__global const float *brightness, __local const float *near, const int width, const int height,
                      const int x, const int y, Floats *now, Floats *moved) {
    __global const float *row = brightness + y * width;
    const Ints column = clamp(x + LANE_NUMBERS, (Ints)(0), (Ints)(width - 1));
    *now = x >= 0 && x + LANES <= width ? load_floats(0, row + x) : gather_floats(row, column);
    Sample there;
    find_sample(row_indices(x) + flow_at(near, x, y), (float)y + flow_at(near + FLOW_PLANE, x, y), width, height,
                &there);
    *moved = sampled(brightness + width * height, &there);
}

/* Mean over the 3x3 pixels around those of the tile from (x, y) on, or over those of them that there are. */
INLINE Floats mean_around(__local const float *sums, const int width, const int height, const int x, const int y) {
    const int top = max(y, 1 - TILE_Y), bottom = min(y + 2, height - TILE_Y);
    Floats sum = 0.0f, columns = 0.0f;
    for (int dx = -1; dx <= 1; ++dx) {
        const Ints column = TILE_X + x + dx + LANE_NUMBERS, there = (column >= 0) & (column < width);
        Floats of_column = 0.0f;
        for (int row = top; row <= bottom; ++row) of_column += load_floats(0, sums + row * SUM_PITCH + x + 1 + dx);
        sum += there ? of_column : (Floats)(0.0f);
        columns += there ? (Floats)(1.0f) : (Floats)(0.0f);
    }
    return wide_divide(sum, columns * (float)(bottom + 1 - top));
}

/* Makes a step of the flow at `level`, by least squares, from the flow `begun`, or, if it `doubles`, from that of the
   level below. */
WIDE TILED __kernel void step_flow(__constant Frame *restrict frame, const int level, const int doubles,
                                   __global const float *restrict brightness, __global const float *restrict begun,
                                   __global float *restrict flow) {
    /* both: sum of both images of which the flow is sought; rest: four times their difference */
    __local float near[2 * FLOW_PLANE], both[PIXELS], rest[PIXELS], products[PRODUCTS * SUM_PLANE];
    const int fine = frame->network_width >> level, fine_height = frame->network_height >> level;
    const int width = fine / 2, height = fine_height / 2, plane = width * height;
    load_flow(begun, doubles, width, height, near);
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM + PIXEL_CHUNKS; i < (PIXEL_ROWS - 1) * PIXEL_CHUNKS; i += ITEMS) {
        const int row = i / PIXEL_CHUNKS, column = LANES * (i % PIXEL_CHUNKS);
        const int x = 2 * TILE_X - PIXELS_AROUND + column, y = 2 * TILE_Y - PIXELS_AROUND + row;
        if (y < 0 || y >= fine_height) continue;
        Floats now, moved;
        load_both(brightness, near, fine, fine_height, x, y, &now, &moved);
        store_floats(now + moved, 0, both + row * PIXEL_PITCH + column);
        store_floats(4.0f * (moved - now), 0, rest + row * PIXEL_PITCH + column);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    /* Means over 2x2 pixels of products of gradients and differences: xx, xy, yy, xr, yr. */
    for (int i = ITEM; i < SUM_ROWS * SUM_CHUNKS; i += ITEMS) {
        const int row = i / SUM_CHUNKS, column = LANES * (i % SUM_CHUNKS);
        if (TILE_Y + row < 1 || TILE_Y + row > height) continue;
        const Ints x = TILE_X - 1 + column + LANE_NUMBERS;
        Floats sums[PRODUCTS];
        for (int k = 0; k < PRODUCTS; ++k) sums[k] = 0.0f;
        for (int part = 0; part < 2; ++part) {
            const int y = 2 * (TILE_Y - 1 + row) + part;
            const int at = (y - 2 * TILE_Y + PIXELS_AROUND) * PIXEL_PITCH + 2 * column - 2 + PIXELS_AROUND;
            __local const float *here = both + at;
            const Pairs left = load_pairs(here - 1), right = load_pairs(here + 1);
            const Pairs top = load_pairs(here - (y > 0 ? PIXEL_PITCH : 0)),
                        bottom = load_pairs(here + (y < fine_height - 1 ? PIXEL_PITCH : 0));
            const Pairs differences = load_pairs(rest + at), down = bottom - top;
            const Floats gradient[2] = {right.even - (x == 0 ? left.odd : left.even),
                                        (x == width - 1 ? right.even : right.odd) - left.odd};
            const Floats gradients_y[2] = {down.even, down.odd}, difference[2] = {differences.even, differences.odd};
            for (int side = 0; side < 2; ++side) {
                const Floats gradient_y = gradients_y[side];
                sums[0] += gradient[side] * gradient[side];
                sums[1] += gradient[side] * gradient_y;
                sums[2] += gradient_y * gradient_y;
                sums[3] += gradient[side] * difference[side];
                sums[4] += gradient_y * difference[side];
            }
        }
        for (int k = 0; k < PRODUCTS; ++k)
            store_floats(0.25f * sums[k], 0, products + k * SUM_PLANE + row * SUM_PITCH + column);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM; i < CHUNKS(TILE_WIDTH) * TILE_HEIGHT; i += ITEMS) {
        const int x = LANES * (i % CHUNKS(TILE_WIDTH)), y = i / CHUNKS(TILE_WIDTH);
        const int count = width - TILE_X - x, at = (TILE_Y + y) * width + TILE_X + x;
        if (count <= 0 || TILE_Y + y >= height) continue;
        Floats mean[PRODUCTS];
        for (int k = 0; k < PRODUCTS; ++k) mean[k] = mean_around(products + k * SUM_PLANE, width, height, x, y);
        const Floats xx = mean[0] + FLAT, xy = mean[1], yy = mean[2] + FLAT, xr = mean[3], yr = mean[4];
        const Floats determinant = xx * yy - xy * xy;
        const Floats step_x = wide_divide(xy * yr - yy * xr, determinant),
                     step_y = wide_divide(xy * xr - xx * yr, determinant);
        const Floats longer = wide_greater(fabs(step_x), fabs(step_y)),
                     excess = wide_greater((1.0f / LONGEST_STEP) * longer, (Floats)(1.0f));
        __local const float *here = near + (y + AROUND) * FLOW_PITCH + x + AROUND;
        store_some_floats(load_floats(0, here) + wide_divide(step_x, excess), count, flow + at);
        store_some_floats(load_floats(0, here + FLOW_PLANE) + wide_divide(step_y, excess), count, flow + plane + at);
    }
}

/* Squared differences of brightness at pixels of an image of `fine` by `fine_height`, around a tile: in place and along
   the flow. */
INLINE void square_differences(__global const float *brightness, __local const float *near, const int fine,
                               const int fine_height, __local float *still, __local float *along) {
    for (int i = ITEM + 2 * PIXEL_CHUNKS; i < (PIXEL_ROWS - 2) * PIXEL_CHUNKS; i += ITEMS) {
        const int row = i / PIXEL_CHUNKS, column = LANES * (i % PIXEL_CHUNKS);
        const int x = 2 * TILE_X - PIXELS_AROUND + column, y = 2 * TILE_Y - PIXELS_AROUND + row;
        if (y < 0 || y >= fine_height) continue;
        Floats now, moved;
        load_both(brightness, near, fine, fine_height, x, y, &now, &moved);
        const Ints there = y * fine + clamp(x + LANE_NUMBERS, (Ints)(0), (Ints)(fine - 1));
        const Floats in_place = gather_floats(brightness + fine * fine_height, there) - now, followed = moved - now;
        store_floats(in_place * in_place, 0, still + row * PIXEL_PITCH + column);
        store_floats(followed * followed, 0, along + row * PIXEL_PITCH + column);
    }
}

/* Mean of such squares over the 2x2 pixels of those of the sums from `column` of `row` on. */
INLINE Floats mean_of_pixels(__local const float *squares, const int row, const int column) {
    __local const float *first = squares + (2 * row - 2 + PIXELS_AROUND) * PIXEL_PITCH + 2 * column - 2 + PIXELS_AROUND;
    const Pairs top = load_pairs(first), bottom = load_pairs(first + PIXEL_PITCH);
    return 0.25f * (top.even + top.odd + bottom.even + bottom.odd);
}

/* Makes mean squared differences nearby, at level 2: means over 2x2 pixels of level 1 of the brightness of both frames,
   in place and along the flow; and of its change from the previous interval's, in place and along the flow. */
WIDE TILED __kernel void find_differences(__constant Frame *restrict frame, __global const float *restrict brightness,
                                          __global const float *restrict coarser, __global const float *restrict flow,
                                          __global const float *restrict trends, __global float *restrict differences) {
    __local float near[2 * FLOW_PLANE], still[PIXELS], along[PIXELS], squares[DIFFERENCES * SUM_PLANE];
    const int fine = frame->network_width / 2, fine_height = frame->network_height / 2;
    const int width = fine / 2, height = fine_height / 2, plane = width * height;
    __global const float *repeated = trends + 4 * REPEATED * plane;
    load_flow(flow, false, width, height, near);
    barrier(CLK_LOCAL_MEM_FENCE);

    square_differences(brightness, near, fine, fine_height, still, along);
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM; i < SUM_ROWS * SUM_CHUNKS; i += ITEMS) {
        const int row = i / SUM_CHUNKS, column = LANES * (i % SUM_CHUNKS), y = TILE_Y - 1 + row;
        if (y < 0 || y >= height) continue;
        const Ints x = clamp(TILE_X - 1 + column + LANE_NUMBERS, (Ints)(0), (Ints)(width - 1)), at = y * width + x;
        Floats of_repeated[4];
        for (int part = 0; part < 4; ++part)
            of_repeated[part] = gather_floats(repeated, (2 * y + (part >> 1)) * fine + 2 * x + (part & 1));
        __local const float *here = near + (row - 1 + AROUND) * FLOW_PITCH + column - 1 + AROUND;
        const Floats flow_x = load_floats(0, here), flow_y = load_floats(0, here + FLOW_PLANE);
        Sample there;
        find_sample(2.0f * to_floats(x) + 0.5f + flow_x, 2.0f * (float)y + 0.5f + flow_y, fine, fine_height, &there);
        const Floats changed = gather_floats(coarser, at) - gather_floats(coarser + plane, at);
        const Floats again = changed - mean_of_quad(of_repeated), again_along = changed - sampled(repeated, &there);
        __local float *out = squares + row * SUM_PITCH + column;
        store_floats(mean_of_pixels(still, row, column), 0, out);
        store_floats(mean_of_pixels(along, row, column), 0, out + SUM_PLANE);
        store_floats(again * again, 0, out + 2 * SUM_PLANE);
        store_floats(again_along * again_along, 0, out + 3 * SUM_PLANE);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM; i < CHUNKS(TILE_WIDTH) * TILE_HEIGHT; i += ITEMS) {
        const int x = LANES * (i % CHUNKS(TILE_WIDTH)), y = i / CHUNKS(TILE_WIDTH);
        const int count = width - TILE_X - x, at = (TILE_Y + y) * width + TILE_X + x;
        if (count <= 0 || TILE_Y + y >= height) continue;
        for (int k = 0; k < DIFFERENCES; ++k)
            store_some_floats(mean_around(squares + k * SUM_PLANE, width, height, x, y), count,
                              differences + k * plane + at);
    }
}

/* Whether inverse depth bends in the 2x2 pixels of level 0 that pixels from (x, y) of level 1 on have. That of a plane
   does not. */
INLINE Ints is_rough(__global const float *frames, const int fine, const int fine_height, const int x, const int y) {
    __global const float *inverse = frames + INVERSE_DEPTH * fine * fine_height;
    Ints rough = 0;
    for (int part = 0; part < 4; ++part) {
        const Ints column = 2 * (x + LANE_NUMBERS) + (part & 1);
        const int row = 2 * y + (part >> 1), above = max(row - 1, 0), below = min(row + 1, fine_height - 1);
        const Ints left = max(column - 1, (Ints)(0)), right = min(column + 1, (Ints)(fine - 1));
        const Floats here = gather_floats(inverse, row * fine + column), most = BENT * here;
        const Floats across =
            gather_floats(inverse, row * fine + left) + gather_floats(inverse, row * fine + right) - 2.0f * here;
        const Floats down =
            gather_floats(inverse, above * fine + column) + gather_floats(inverse, below * fine + column) - 2.0f * here;
        rough |= (fabs(across) > most) | (fabs(down) > most);
    }
    return rough;
}

/* Whether the flow varies much among the 3x3 pixels around those of a tile from (x, y) on. */
INLINE Ints varies(__local const float *near, const int x, const int y) {
    Ints much = 0;
    for (int axis = 0; axis < 2; ++axis) {
        __local const float *first = near + axis * FLOW_PLANE + (y - 1 + AROUND) * FLOW_PITCH + x - 1 + AROUND;
        Floats least = load_floats(0, first), most = least;
        for (int k = 1; k < 9; ++k) {
            const Floats other = load_floats(0, first + k / 3 * FLOW_PITCH + k % 3);
            least = wide_lesser(least, other);
            most = wide_greater(most, other);
        }
        much |= !(most - least < FLOW_VARIES);
    }
    return much;
}

/* At level 1, 1 where the image is to follow the flow, else 0: the flow explains how the previous frame, warped along
   motion vectors, became the new one, and these do not. `flow` is that of level 2. */
WIDE TILED __kernel void find_followed(__constant Frame *restrict frame, __global const float *restrict frames,
                                       __global const float *restrict brightness, __global const float *restrict flow,
                                       __global const int *restrict changed, __global float *restrict followed) {
    __local float near[2 * FLOW_PLANE], still[PIXELS], along[PIXELS], squares[2 * SUM_PLANE];
    __local int unlike; /* whether both frames differ anywhere in the tile */
    const int fine = frame->network_width, fine_height = frame->network_height;
    const int width = fine / 2, height = fine_height / 2;
    const float longest = (float)fine * (1.0f / LONGEST_FLOW);
    if (ITEM == 0) unlike = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = ITEM + 2 * PIXEL_CHUNKS; *changed && i < (PIXEL_ROWS - 2) * PIXEL_CHUNKS; i += ITEMS) {
        const int x = 2 * TILE_X - PIXELS_AROUND + LANES * (i % PIXEL_CHUNKS),
                  y = 2 * TILE_Y - PIXELS_AROUND + i / PIXEL_CHUNKS;
        const Ints there = clamp(y, 0, fine_height - 1) * fine + clamp(x + LANE_NUMBERS, (Ints)(0), (Ints)(fine - 1));
        const Floats change = gather_floats(brightness + fine * fine_height, there) - gather_floats(brightness, there);
        if (ANY(change * change > UNLIKE)) atomic_or(&unlike, 1);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    if (unlike) load_flow(flow, true, width, height, near);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (unlike) square_differences(brightness, near, fine, fine_height, still, along);
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM; unlike && i < SUM_ROWS * SUM_CHUNKS; i += ITEMS) {
        const int row = i / SUM_CHUNKS, column = LANES * (i % SUM_CHUNKS), y = TILE_Y - 1 + row;
        if (y < 0 || y >= height) continue;
        store_floats(mean_of_pixels(still, row, column), 0, squares + row * SUM_PITCH + column);
        store_floats(mean_of_pixels(along, row, column), 0, squares + SUM_PLANE + row * SUM_PITCH + column);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    for (int i = ITEM; i < CHUNKS(TILE_WIDTH) * TILE_HEIGHT; i += ITEMS) {
        const int x = LANES * (i % CHUNKS(TILE_WIDTH)), y = i / CHUNKS(TILE_WIDTH);
        const int count = width - TILE_X - x;
        if (count <= 0 || TILE_Y + y >= height) continue;
        Ints follows = 0;
        if (unlike) {
            const Floats in_place = mean_around(squares, width, height, x, y),
                         moved = mean_around(squares + SUM_PLANE, width, height, x, y);
            __local const float *here = near + (y + AROUND) * FLOW_PITCH + x + AROUND;
            follows = (in_place > UNLIKE) & (moved < EXPLAINED * in_place);
            follows &= (fabs(load_floats(0, here)) < longest) & (fabs(load_floats(0, here + FLOW_PLANE)) < longest);
        }
        if (ANY(follows))
            follows &= !(varies(near, x, y) | is_rough(frames, fine, fine_height, TILE_X + x, TILE_Y + y));
        store_some_floats(follows ? (Floats)(1.0f) : (Floats)(0.0f), count,
                          followed + (TILE_Y + y) * width + TILE_X + x);
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
