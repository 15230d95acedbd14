/* Sharpness of the rendered frames' edges, as their own pixels show it. Renderers filter pixels differently: edges that
   a pixel's area has softened are steeper between pixels than interpolation makes them; aliased ones, wide filters and
   noise are not. So the frame before is resampled at a lattice of static samples, and the part of the difference to
   this frame that more sharpness explains is what the new frame is resampled with (resampling.h). */

#include "frame.h"
#include "scene_cuts.h"
#include "resampling.h"

/* What set the constants: docs/deviations.md, "Edges are as sharp as earlier frames were". */
#define SAMPLES_EACH 2 /* rows of samples of a work-item, which takes as many columns */
#define SAME_SHAPE 0.2f /* relative range of depths of one surface around a sample */
#define OTHER_COLOR 0.2f /* difference of codes, white being 1, that is no matter of sharpness */
#define KEPT 0.75f /* of the evidence of the frame before */
#define LEAST_EVIDENCE 0.02f /* with as much evidence, half of the sharpness found counts */
#define SHARPEST 2.0f
#define UNIT 262144.0f /* of sums in integers, which depend on no order */

/* Sums, over the samples, of products: what a sharpness of 1 changes, times the difference that is to be explained, and
   times itself. Of `pending` also the number of work-groups that have added theirs. */
enum { EXPLAINED, CHANGED, ADDED };

/* The codes of two pixels of a color image. */
INLINE float8 two_codes(__global const half *color, const int i, const float offset) {
    return (float8)(load_code(color, i, offset), 0.0f, load_code(color, i + 1, offset), 0.0f);
}

/* Adds a sample at (x, y), white being 1: `sums` by EXPLAINED and CHANGED. */
INLINE void compare(const int x, const int y, __constant Frame *frame, __global const half *color,
                    __global const float *depth, __global const uchar *dynamic_mask, __global const half *color_prev,
                    __global const float *depth_prev, float *sums) {
    const int width = frame->source_width, height = frame->source_height, src = y * width + x;
    const float offset = frame->code_offset, z = depth[src];
    if (INVALID_DEPTH(z) || isinf(z) || dynamic_mask[src] != STATIC) return;
    const float3 px = reproject(pixel_center(x, y), z, frame->to_previous);
    const int left = (int)floor(px.x - 0.5f), top = (int)floor(px.y - 0.5f), first = (top - 1) * width + left - 1;
    if (!(px.z > 0.0f && left >= 1 && top >= 1 && left < width - 2 && top < height - 2)) return;
    for (int k = 0; k < 4; ++k) {
        const float met = depth_prev[(top + (k >> 1)) * width + left + (k & 1)];
        if (!is_same_surface(met, px.z, SAME_SHAPE * px.z)) return;
    }
    const float u = px.x - 0.5f - (float)left, v = px.y - 0.5f - (float)top;
    const float8 a = two_codes(color_prev, first + 1, offset), d = two_codes(color_prev, first + 3 * width + 1, offset);
    const float16 b = (float16)(two_codes(color_prev, first + width, offset),
                                two_codes(color_prev, first + width + 2, offset)),
                  c = (float16)(two_codes(color_prev, first + 2 * width, offset),
                                two_codes(color_prev, first + 2 * width + 2, offset));
    float3 made[2];
    for (int k = 0; k < 2; ++k) {
        const Sharpening s = sharpening((float)k, offset);
        const float4 wx = cubic_weights(u, s.slope), wy = cubic_weights(v, s.slope);
        made[k] =
            cubic_of_rows(a, b, c, d, without_corners(wx, wy), wy, s.steeper * MIDWAY(u, v), s.per_range).xyz;
    }
    const float per_white = sharpening(0.0f, offset).per_range * FULL_RANGE;
    const float3 off = (fmin(load_code(color, src, offset) * per_white, 1.0f) - fmin(made[0] * per_white, 1.0f)),
                 change = (made[1] - made[0]) * per_white;
    if (fmax(fabs(off.x), fmax(fabs(off.y), fabs(off.z))) > OTHER_COLOR) return;
    sums[EXPLAINED] += off.x * change.x + off.y * change.y + off.z * change.z;
    sums[CHANGED] += change.x * change.x + change.y * change.y + change.z * change.z;
}

/* A row of samples per work-group, SAMPLES_EACH each way per work-item. The last group finds the sharpness. */
__kernel __attribute__((reqd_work_group_size(SAMPLES_X, 1, 1))) void
measure_sharpness(__constant Frame *restrict frame, __global const half *color, __global const float *depth,
                  __global const uchar *dynamic_mask, __global const half *color_prev, __global const float *depth_prev,
                  __global int *pending, __global float *evidence, __global float *sharpness) {
    const int width = frame->source_width, height = frame->source_height, item = get_local_id(0);
    const int columns = min(width, SAMPLES_EACH * SAMPLES_X), groups = min(height, SAMPLES_Y),
              rows = min(height, SAMPLES_EACH * groups);
    if (!frame->has_previous) {
        if (get_global_id(0) + get_global_id(1) == 0) evidence[EXPLAINED] = evidence[CHANGED] = *sharpness = 0.0f;
        return;
    }
    __local int of_group[2];
    if (item < 2) of_group[item] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    float sums[2] = {0.0f, 0.0f};
    for (int row = get_global_id(1); row < rows; row += groups)
        for (int column = item; column < columns; column += SAMPLES_X)
            compare((2 * column + 1) * width / (2 * columns), (2 * row + 1) * height / (2 * rows), frame, color, depth,
                    dynamic_mask, color_prev, depth_prev, sums);
    for (int k = 0; k < 2; ++k) atomic_add(of_group + k, (int)floor(UNIT * sums[k] + 0.5f));
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item) return;
    /* A group counts itself only by the values that its additions return: so the last one misses none. */
    const int explained = atomic_add(pending + EXPLAINED, of_group[EXPLAINED]),
              changed = atomic_add(pending + CHANGED, of_group[CHANGED]);
    if (atomic_add(pending + ADDED, 1 + (changed < 0) + (explained == INT_MIN)) != groups - 1) return;
    const float new_explained = (float)atomic_xchg(pending + EXPLAINED, 0) * (1.0f / UNIT),
                new_changed = (float)atomic_xchg(pending + CHANGED, 0) * (1.0f / UNIT);
    atomic_xchg(pending + ADDED, 0);
    if (!(new_changed > 0.0f)) return; /* nothing moved */
    const float all_explained = KEPT * evidence[EXPLAINED] + new_explained,
                all_changed = KEPT * evidence[CHANGED] + new_changed;
    evidence[EXPLAINED] = all_explained;
    evidence[CHANGED] = all_changed;
    *sharpness = clamp(divide(all_explained, all_changed + LEAST_EVIDENCE), 0.0f, SHARPEST);
}
