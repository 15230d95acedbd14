/* Sharpness of the rendered frames' edges, as their own pixels show it. Renderers filter pixels differently: edges that
   a pixel's area has softened are steeper between pixels than interpolation makes them; aliased ones, wide filters and
   noise are not. So the frame before is resampled at a lattice of samples, and the part of the difference to
   this frame that more sharpness explains is what the new frame is resampled with (resampling.h). */

#include "frame.h"
#include "scene_cuts.h"
#include "resampling.h"

/* What set the constants: docs/deviations.md, "Edges are as sharp as earlier frames were". */
#define SAME_SHAPE 0.2f /* relative range of depths of one surface around a sample */
#define EVIDENCE_KEPT 0.9f /* of the evidence of the frame before */
#define EXPECTED 0.8f /* sharpness without evidence */
#define LEAST_EVIDENCE 0.02f /* with as much evidence, half of the sharpness found counts, and half of the EXPECTED */
#define SHARPEST 2.0f
#define UNIT 524288.0f /* of sums in integers, which depend on no order: no sample adds more than 1 */

/* Sums, over the samples, of products: what a sharpness of 1 changes, times the difference that is to be explained, and
   times itself. Of `pending` also the number of work-groups that have added theirs. */
enum { EXPLAINED, CHANGED, ADDED };

/* An image, and 1 / the color that is displayed as white. */
typedef struct {
    __global const half *color;
    float per_white;
} Shown;

/* Luminance of a pixel as it is displayed, about, in a code in which equal steps look about equal. NaN counts as 0. */
INLINE float luma(const int i, const Shown image) {
    const float4 c = load_texel(i, image.color);
    const float light = (0.25f * c.x + 0.5f * c.y + 0.25f * c.z) * image.per_white;
    const float dark = 1.0f - fmin(fmax(light, 0.0f), 1.0f), dark2 = dark * dark;
    return 1.0f - dark2 * dark2;
}

#define OF_SAMPLE(v, k) float_of(&(v), k)
#define IS_TRUE(condition) (condition)
DEFINE_CUBIC(float, const Shown, luma, OF_SAMPLE, IS_TRUE, cubic_luma)

/* Adds a sample at (x, y): `sums` by EXPLAINED and CHANGED. */
INLINE void compare(const int x, const int y, __constant Frame *frame, __global const half *color,
                    __global const float *depth, __global const float2 *motion, __global const uchar *dynamic_mask,
                    __global const half *color_prev, __global const float *depth_prev, float *sums) {
    const int width = frame->source_width, height = frame->source_height, src = y * width + x;
    const float z = depth[src];
    if (INVALID_DEPTH(z) || isinf(z)) return;
    const float3 px = dynamic_mask[src] == STATIC ? reproject(pixel_center(x, y), z, frame->to_previous)
                                                  : (float3)(pixel_center(x, y) + motion[src], z);
    if (!(px.z > 0.0f && holds(width, height, px.xy))) return;
    const int left = (int)floor(px.x - 0.5f), top = (int)floor(px.y - 0.5f);
    if (!(left >= 1 && top >= 1 && left < width - 2 && top < height - 2)) return;
    for (int k = 0; k < 4; ++k) {
        const float met = depth_prev[(top + (k >> 1)) * width + left + (k & 1)];
        if (!is_same_surface(met, px.z, SAME_SHAPE * px.z)) return;
    }
    const float u = px.x - 0.5f - (float)left, v = px.y - 0.5f - (float)top;
    if (u == 0.0f && v == 0.0f) return; /* nothing changes at the centers of pixels */
    const float per_white = divide(1.0f, display_white(frame->code_offset));
    const Shown now = {color, per_white}, before = {color_prev, per_white};
    const int columns[4] = {-1, 0, 1, 2}, rows[4] = ROWS_OF_TAPS(top * width + left, width);
    Cubic cubic;
    cubic_between((Floats)(u), (Floats)(v), sharpening(0.0f, 1.0f), &cubic);
    const float plain = cubic_luma(columns, rows, &cubic, 0, before);
    cubic_between((Floats)(u), (Floats)(v), sharpening(1.0f, 1.0f), &cubic);
    const float change = cubic_luma(columns, rows, &cubic, 0, before) - plain;
    sums[EXPLAINED] += (luma(src, now) - plain) * change;
    sums[CHANGED] += change * change;
}

/* A sample per work-item, a row of them per work-group. The last group finds the sharpness. */
__kernel __attribute__((reqd_work_group_size(SAMPLES_X, 1, 1))) void
measure_sharpness(__constant Frame *restrict frame, __global const half *color, __global const float *depth,
                  __global const float2 *motion, __global const uchar *dynamic_mask, __global const half *color_prev,
                  __global const float *depth_prev, __global int *pending, __global float *evidence,
                  __global float *sharpness) {
    const int width = frame->source_width, height = frame->source_height, item = get_local_id(0);
    const int columns = min(width, SAMPLES_X), rows = min(height, SAMPLES_Y), row = get_global_id(1);
    __local int of_group[2];
    if (item < 2) of_group[item] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    float sums[2] = {0.0f, 0.0f};
    if (frame->has_previous && item < columns)
        compare((2 * item + 1) * width / (2 * columns), (2 * row + 1) * height / (2 * rows), frame, color, depth,
                motion, dynamic_mask, color_prev, depth_prev, sums);
    for (int k = 0; k < 2; ++k) atomic_add(of_group + k, (int)floor(UNIT * sums[k] + 0.5f));
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item) return;
    if (!frame->has_previous) {
        if (row == 0) evidence[EXPLAINED] = evidence[CHANGED] = *sharpness = 0.0f;
        return;
    }
    /* A group counts itself only by the values that its additions return: so the last one misses none. */
    const int explained = atomic_add(pending + EXPLAINED, of_group[EXPLAINED]),
              changed = atomic_add(pending + CHANGED, of_group[CHANGED]);
    if (atomic_add(pending + ADDED, 1 + (changed < 0) + (explained == INT_MIN)) != rows - 1) return;
    const float new_explained = (float)atomic_xchg(pending + EXPLAINED, 0) * (1.0f / UNIT),
                new_changed = (float)atomic_xchg(pending + CHANGED, 0) * (1.0f / UNIT);
    atomic_xchg(pending + ADDED, 0);
    if (!(new_changed > 0.0f)) return; /* nothing moved */
    const float all_explained = EVIDENCE_KEPT * evidence[EXPLAINED] + new_explained,
                all_changed = EVIDENCE_KEPT * evidence[CHANGED] + new_changed;
    evidence[EXPLAINED] = all_explained;
    evidence[CHANGED] = all_changed;
    *sharpness = clamp(divide(all_explained + EXPECTED * LEAST_EVIDENCE, all_changed + LEAST_EVIDENCE), 0.0f, SHARPEST);
}
