/* The trend of shading (beyond the paper): how encoded color changed on static surfaces from rendered frame t-1 to
   t, over wide areas, and that of the interval before, carried on to t + alpha. Slow changes of light continue;
   flicker and turns do not: the shading correction network tells them apart. A cell has 8x8 pixels of the rendered
   image; a few of them stand for all. */

#include "frame.h"
#include "mu_law.h"
#include "simd_rgb.h"
#include "thresholds.h"

/* What set the thresholds: docs/deviations.md, "Flickering light is left alone". */
/* SPACING_SHARE: rows of the image per cell from one of the 5x5 cells around to the next: their sigma is about a 34th
   of its height */
#define SPACING_SHARE 240
#define TREND_CELLS 2 /* of these cells, each way */
#define CELL 8
#define SAMPLE_STRIDE 4        /* px, from the second pixel of a cell on */
#define MOST_CHANGE 1048576.0f /* factor of one pixel's color: products over a cell stay within floats */
#define CHANGES 4              /* planes: of R, G, B, and the share of samples that are static in both frames */
#define THIRD 0.33333334f
#define LEAST_SHARE 0.05f      /* of a neighborhood: fewer samples count less */
#define NOISE 1.033831f        /* factor of lifted color, 1/256 of encoded color, up to which nothing changed, ... */
#define FEW 8                  /* ... and samples, of 64 in a tile, that may change more, as aliased edges do */
#define TILE 4                 /* cells, each way, for which that is decided */

/* Rendered frames t and t-1. */
typedef struct {
    __global const half *color, *color_prev;
    __global const float *depth, *depth_prev;
    __global const uchar *dynamic_mask;
} Frames;

/* The factor by which lifted colors have changed since t-1, 1 where it is not known. */
typedef struct {
    Floats factor[3];
    Ints known, moves;
} Change;

INLINE Floats factor_of(const Floats now, const Floats before, const Ints known, const float4 law) {
    const Floats factor = wide_divide(lifted(now, law), lifted(before, law));
    return known ? clamp(factor, (Floats)(1.0f / MOST_CHANGE), (Floats)(MOST_CHANGE)) : (Floats)(1.0f);
}

/* The change of the pixels (x, y). */
INLINE void change_at(const Ints x, const int y, __constant Frame *frame, const Frames f, Change *c) {
    const int width = frame->source_width, height = frame->source_height;
    const Ints in_image = (x < width) & ((Ints)(y) < height);
    const Ints src = min(y, height - 1) * width + min(x, (Ints)(width - 1));
    const Floats z = gather_floats(f.depth, src);
    c->moves = in_image & (to_ints(gather_bytes(f.dynamic_mask, src)) != STATIC);
    const Wide3 before = wide_reproject(to_floats(x) + 0.5f, (float)y + 0.5f, z, frame->to_previous);
    const Floats px_x = before.x - 0.5f, px_y = before.y - 0.5f;
    c->known = in_image & !c->moves & (z > 0.0f) & (before.z > 0.0f) & (px_x >= 0.0f) & (px_y >= 0.0f)
               & (px_x < (float)(width - 1)) & (px_y < (float)(height - 1));
    const Ints x0 = to_ints(c->known ? px_x : (Floats)(0.0f)), y0 = to_ints(c->known ? px_y : (Floats)(0.0f)),
               first = y0 * width + x0;
    const Floats u = px_x - to_floats(x0), v = px_y - to_floats(y0);
    const Floats tolerance = isinf(before.z) ? (Floats)(0.0f) : SAME_SURFACE * before.z;
    Floats sum[3] = {0.0f, 0.0f, 0.0f};
    for (int tap = 0; tap < 4; ++tap) {
        const int dx = tap & 1, dy = tap >> 1;
        const Ints at = c->known ? first + (dy * width + dx) : (Ints)(0);
        const Floats z_prev = gather_floats(f.depth_prev, at);
        c->known &= (z_prev == before.z) | (fabs(z_prev - before.z) <= tolerance);
        const Floats weight = (dx ? u : 1.0f - u) * (dy ? v : 1.0f - v);
        const Wide4 rgb = finite_rgb(gather_channels(f.color_prev, at));
#pragma unroll
        for (int k = 0; k < 3; ++k) sum[k] += weight * rgb.c[k];
    }
    const Wide4 now = finite_rgb(gather_channels(f.color, src));
#pragma unroll
    for (int k = 0; k < 3; ++k) c->factor[k] = factor_of(now.c[k], sum[k], c->known, frame->color_law);
}

INLINE Ints is_more_than_noise(const Floats factor) { return (factor > NOISE) | (factor * NOISE < 1.0f); }

/* Planes of the summed change of encoded color of a cell's samples, and of the share that is known, over the number
   of samples; and how many samples move or change by more than noise. */
WIDE __kernel void measure_changes(__constant Frame *restrict frame, __global const half *color,
                                   __global const float *depth, __global const uchar *dynamic_mask,
                                   __global const half *color_prev, __global const float *depth_prev,
                                   __global float *changes, __global uchar *changed_samples, __global int *changed) {
    const Frames frames = {color, color_prev, depth, depth_prev, dynamic_mask};
    const int cells_width = frame->cells_width, cells_height = frame->cells_height;
    const int first_x = get_global_id(0) * LANES, cell_y = get_global_id(1);
    if (first_x >= cells_width || cell_y >= cells_height) return;
    if (first_x == 0 && cell_y == 0) *changed = 0; /* for find_trend */
    const int count = min(LANES, cells_width - first_x), plane = cells_width * cells_height;
    Floats factor[3] = {1.0f, 1.0f, 1.0f}, known = 0.0f;
    Ints differing = 0;
    for (int y = 1; y < CELL; y += SAMPLE_STRIDE)
        for (int x = 1; x < CELL; x += SAMPLE_STRIDE) {
            Change c;
            change_at((first_x + LANE_NUMBERS) * CELL + x, cell_y * CELL + y, frame, frames, &c);
            known += c.known ? (Floats)(1.0f) : (Floats)(0.0f);
            Ints differs = c.moves;
            for (int k = 0; k < 3; ++k) {
                factor[k] *= c.factor[k];
                differs |= is_more_than_noise(c.factor[k]);
            }
            differing += differs & 1;
        }
    const float share = (float)(SAMPLE_STRIDE * SAMPLE_STRIDE) / (float)(CELL * CELL);
    const int cell = cell_y * cells_width + first_x;
    for (int c = 0; c < 3; ++c)
        store_some_floats(log_of(factor[c]) * (frame->color_law.y * share), count, changes + c * plane + cell);
    store_some_floats(known * share, count, changes + 3 * plane + cell);
    store_some_bytes(to_bytes(differing), count, changed_samples + cell);
}

/* Whether more than a FEW samples change in any of the tiles of TILE x TILE cells whose first cells are LANES from
   (first_x, first_y) on. */
INLINE bool changes_in_tiles(__global const uchar *changed_samples, const int first_x, const int first_y,
                             const int cells_width, const int cells_height) {
    bool changes = false;
    for (int x0 = first_x; x0 < min(first_x + LANES, cells_width); x0 += TILE) {
        int sum = 0;
        for (int y = first_y; y < min(first_y + TILE, cells_height); ++y)
            for (int x = x0; x < min(x0 + TILE, cells_width); ++x) sum += changed_samples[y * cells_width + x];
        changes |= sum > FEW;
    }
    return changes;
}

/* Means of known values over 5x5 cells around each, which count the less the farther away they are; beyond the image
   there is nothing. And whether anything changes; measure_changes has set that to 0. */
WIDE __kernel void find_trend(__constant Frame *restrict frame, __global const float *changes,
                              __global const uchar *changed_samples, __global float *trend, __global int *changed) {
    const int cells_width = frame->cells_width, cells_height = frame->cells_height;
    const int cell_x = get_global_id(0) * LANES, cell_y = get_global_id(1), count = cells_width - cell_x;
    const int spacing = max(1, frame->source_height / SPACING_SHARE);
    if (cell_x >= cells_width || cell_y >= cells_height) return;
    if (cell_x % TILE == 0 && cell_y % TILE == 0
        && changes_in_tiles(changed_samples, cell_x, cell_y, cells_width, cells_height))
        atomic_or(changed, 1);
    const int plane = cells_width * cells_height, cell = cell_y * cells_width + cell_x;
    Floats sum[CHANGES];
    for (int c = 0; c < CHANGES; ++c) sum[c] = 0.0f;
    for (int dy = -TREND_CELLS; dy <= TREND_CELLS; ++dy) {
        const int y = cell_y + dy * spacing;
        if (y < 0 || y >= cells_height) continue;
        for (int dx = -TREND_CELLS; dx <= TREND_CELLS; ++dx) {
            const Ints x = cell_x + dx * spacing + LANE_NUMBERS, there = clamp(x, (Ints)(0), (Ints)(cells_width - 1));
            const float share = (float)((TREND_CELLS + 1 - abs(dx)) * (TREND_CELLS + 1 - abs(dy))) * (1.0f / 81.0f);
            const Floats weight = x == there ? (Floats)(share) : (Floats)(0.0f);
            for (int c = 0; c < CHANGES; ++c)
                sum[c] += weight * gather_floats(changes + c * plane + y * cells_width, there);
        }
    }
    const Floats share = wide_greater(sum[3], (Floats)(LEAST_SHARE));
    for (int c = 0; c < 3; ++c) store_some_floats(wide_divide(sum[c], share), count, trend + c * plane + cell);
    store_some_floats(sum[3], count, trend + 3 * plane + cell);
}

/* The four cells around positions in a rendered image, and their weights; 0 behind the camera. */
typedef struct {
    Ints tap[4];
    Floats weight[4];
} Cells;

INLINE Cells cells_at(const Wide3 px, const int cells_width, const int cells_height) {
    const Floats x = clamp(px.x * (1.0f / CELL) - 0.5f, (Floats)(0.0f), (Floats)((float)(cells_width - 1)));
    const Floats y = clamp(px.y * (1.0f / CELL) - 0.5f, (Floats)(0.0f), (Floats)((float)(cells_height - 1)));
    const Ints x0 = to_ints(x), y0 = to_ints(y), right = min(x0 + 1, (Ints)(cells_width - 1)) - x0;
    const Ints down = (min(y0 + 1, (Ints)(cells_height - 1)) - y0) * cells_width;
    const Floats u = x - to_floats(x0), v = y - to_floats(y0), shown = px.z > 0.0f ? (Floats)(1.0f) : (Floats)(0.0f);
    const Ints first = y0 * cells_width + x0;
    const Floats of_left = shown * (1.0f - u), of_right = shown * u;
    const Cells c = {{first, first + right, first + down, first + down + right},
                     {of_left * (1.0f - v), of_right * (1.0f - v), of_left * v, of_right * v}};
    return c;
}

INLINE Floats trend_at(__global const float *plane, const Cells *c) {
    return (c->weight[0] * gather_floats(plane, c->tap[0]) + c->weight[1] * gather_floats(plane, c->tap[1]))
           + (c->weight[2] * gather_floats(plane, c->tap[2]) + c->weight[3] * gather_floats(plane, c->tap[3]));
}

/* The trends of the last two intervals, continued to t + alpha, each looked up at the static surface's position
   then, and the valid share of the last one; and the change of brightness nearby in the interval before. */
WIDE __kernel void carry_trends(__constant Frame *restrict frame, __global const float *depth,
                                __global const float *trend, __global const float *trend_prev,
                                __global const float *changes_prev, __global float *trends) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int width = frame->network_width / 2, height = frame->network_height / 2;
    const int cells_width = frame->cells_width, cells_height = frame->cells_height;
    const float alpha = frame->alpha;
    const int x = get_global_id(0) * LANES, y = get_global_id(1);
    if (x >= width || y >= height) return;
    const Ints dst_x = min(4 * (x + LANE_NUMBERS) + 2, (Ints)(target_width - 1));
    const int dst_y = min(4 * y + 2, target_height - 1);
    const Floats z = gather_floats(depth, dst_y * target_width + dst_x);
    const Floats px_x = to_floats(dst_x) + 0.5f, px_y = (float)dst_y + 0.5f;
    const Cells now = cells_at(wide_reproject(px_x, px_y, z, frame->to_source), cells_width, cells_height);
    const Cells before = cells_at(wide_reproject(px_x, px_y, z, frame->target_to_previous), cells_width, cells_height);
    const int plane = cells_width * cells_height, size = width * height;
    __global float *out = trends + y * width + x;
    for (int c = 0; c < 3; ++c) {
        store_floats(alpha * trend_at(trend + c * plane, &now), 0, out + c * size);
        store_floats(alpha * trend_at(trend_prev + c * plane, &before), 0, out + (3 + c) * size);
    }
    store_floats(trend_at(trend + 3 * plane, &now), 0, out + 6 * size);
    const Floats share = trend_at(changes_prev + 3 * plane, &before),
                 least = wide_greater(share, (Floats)(LEAST_SHARE));
    Floats change = 0.0f;
    for (int c = 0; c < 3; ++c) change += trend_at(changes_prev + c * plane, &before);
    store_floats(wide_divide(THIRD * change, least), 0, out + 7 * size);
}
