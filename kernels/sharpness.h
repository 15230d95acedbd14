/* Sharpness of the rendered frames' edges, as their own pixels show it. Renderers filter pixels differently: edges that
   a pixel's area has softened are steeper between pixels than interpolation makes them; aliased ones, wide filters and
   noise are not. So the frame before is resampled at a lattice of samples, and the part of the difference to
   this frame that more sharpness explains is what the new frame is resampled with (resampling.h). */

#include "resampling.h"

/* What set the constants: docs/deviations.md, "Edges are as sharp as earlier frames were". */
#define SAME_SHAPE 0.2f /* relative range of depths of one surface around a sample */
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
#define luma_at(row, column, image) luma((row) + (column), image)
DEFINE_CUBIC(float, const Shown, luma_at, OF_SAMPLE, IS_TRUE, cubic_luma)

/* Adds a sample of a row to `sums`, by EXPLAINED and CHANGED. */
INLINE void compare_sample(const int column, const int row, const int width, const int height, const float code_offset,
                           const Reprojection to_previous, __global const half *color, __global const float *depth,
                           __global const float2 *motion, __global const half *color_prev,
                           __global const float *depth_prev, __local int *sums) {
    const int columns = min(width, SAMPLES_X), rows = min(height, SAMPLES_Y);
    if (column >= columns) return;
    const int x = (2 * column + 1) * width / (2 * columns), y = (2 * row + 1) * height / (2 * rows);
    const int src = y * width + x;
    const float z = depth[src];
    if (INVALID_DEPTH(z) || isinf(z)) return;
    /* Vectors may be quantized: static points are reprojected. */
    const float3 still = reproject(pixel_center(x, y), z, to_previous);
    const float2 moved = pixel_center(x, y) + motion[src], off = moved - still.xy;
    const float3 px = off.x * off.x + off.y * off.y <= STATIC_PX * STATIC_PX ? still : (float3)(moved, z);
    if (!(px.z > 0.0f && holds(width, height, px.xy))) return;
    const int left = (int)floor(px.x - 0.5f), top = (int)floor(px.y - 0.5f);
    if (!(left >= 1 && top >= 1 && left < width - 2 && top < height - 2)) return;
    for (int k = 0; k < 4; ++k) {
        const float met = depth_prev[(top + (k >> 1)) * width + left + (k & 1)];
        if (!is_same_surface(met, px.z, SAME_SHAPE * px.z)) return;
    }
    const float u = px.x - 0.5f - (float)left, v = px.y - 0.5f - (float)top;
    if (u == 0.0f && v == 0.0f) return; /* nothing changes at the centers of pixels */
    const float per_white = divide(1.0f, display_white(code_offset));
    const Shown now = {color, per_white}, before = {color_prev, per_white};
    const int tap_columns[4] = {-1, 0, 1, 2}, tap_rows[4] = ROWS_OF_TAPS(top * width + left, width);
    float plain = 0.0f, sharp = 0.0f;
#pragma unroll 1
    for (int k = 0; k < 2; ++k) {
        Cubic cubic;
        cubic_between((Floats)(u), (Floats)(v), sharpening((float)k, 1.0f), &cubic);
        plain = sharp;
        sharp = cubic_luma(tap_columns, tap_rows, &cubic, 0, before);
    }
    const float change = sharp - plain;
    atomic_add(sums + EXPLAINED, (int)floor(UNIT * (luma(src, now) - plain) * change + 0.5f));
    atomic_add(sums + CHANGED, (int)floor(UNIT * change * change + 0.5f));
}

/* Adds a row's `sums` to `pending`; the last of the `groups` that does so finds the sharpness and leaves zeros. */
INLINE void find_sharpness(__local const int *sums, const int groups, __global int *pending,
                           __global float *sharpness) {
    /* A group counts itself only by the values that its additions return: so the last one misses none. */
    const int explained = atomic_add(pending + EXPLAINED, sums[EXPLAINED]),
              changed = atomic_add(pending + CHANGED, sums[CHANGED]);
    if (atomic_add(pending + ADDED, 1 + (changed < 0) + (explained == INT_MIN)) != groups - 1) return;
    const float all_explained = (float)atomic_xchg(pending + EXPLAINED, 0) * (1.0f / UNIT),
                all_changed = (float)atomic_xchg(pending + CHANGED, 0) * (1.0f / UNIT);
    atomic_xchg(pending + ADDED, 0);
    const float found = divide(all_explained + EXPECTED * LEAST_EVIDENCE, all_changed + LEAST_EVIDENCE);
    *sharpness = all_changed > 0.0f ? clamp(found, 0.0f, SHARPEST) : 0.0f; /* as displays resample what rests */
}
