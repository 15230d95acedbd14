/* Cuts: whether the frame before shares any content with this frame (not in the paper, whose cuts are given). A
   lattice of samples follows its motion vectors. Light may change as it likes: depth is compared, and of color only
   the contrast between neighbors. History tracking counts the samples, beside those of its threshold (history.cl). */

/* What set the thresholds: docs/deviations.md, "Cuts and teleports are detected". */
#define SAMPLES_X 64             /* the lattice, over an image of any size; a row of it is a work-group */
#define SAMPLES_Y 36
#define DEPTH_AGREES 0.02f       /* relative difference of depths of one surface */
#define STATIC_PX 1.0f           /* a vector is the camera's if it is within this distance of the static motion ... */
#define STATIC_SHARE 0.1f        /* ... and the addition per pixel of its length */
#define ARM 2                    /* px from a sample to those whose contrast is compared */
#define CONTRAST_LEAST 0.06f     /* below it there is nothing to compare */
#define CONTRAST_AGREES 0.5f     /* relative difference of contrasts of one surface */
#define TOO_DARK 1.0e-4f             /* linear color, sum of three: noise has no contrast */

/* Counts of samples. */
enum { VALID, INSIDE, COMPARED, DEPTH_RIGHT, WITH_CONTRAST, CONTRAST_RIGHT, PASSED, COUNTS };

INLINE float brightness(__global const half *color, const int x, const int y, const int width) {
    const float3 c = load_color(color, y * width + x);
    return fmax(c.x, 0.0f) + fmax(c.y, 0.0f) + fmax(c.z, 0.0f);
}

/* Contrast between the pixels at -(dx, dy) and (dx, dy) from (x, y), -1 to 1: the same in any light. */
INLINE float contrast(__global const half *color, const int x, const int y, const int dx, const int dy,
                      const int width) {
    const float a = brightness(color, x - dx, y - dy, width), b = brightness(color, x + dx, y + dy, width);
    return divide(b - a, a + b + TOO_DARK);
}

INLINE bool has_arms(const int x, const int y, const int width, const int height) {
    return x >= ARM && y >= ARM && x < width - ARM && y < height - ARM;
}

/* Depth of a pixel's surface in the frame before, unless its vector has movement of its own. */
INLINE float depth_before(const float2 px, const float2 px_prev, const float2 mv_px, const float z,
                          const Reprojection to_previous) {
    if (isinf(z)) return z;
    const float3 px_static = reproject(px, z, to_previous);
    const float dx = px_static.x - px_prev.x, dy = px_static.y - px_prev.y;
    const float most = STATIC_PX + STATIC_SHARE * (fabs(mv_px.x) + fabs(mv_px.y));
    return px_static.z > 0.0f && dx * dx + dy * dy <= most * most ? px_static.z : z;
}

/* Adds the findings at one sample; px_prev is inside. */
INLINE void compare_depth(const float2 px_prev, const float expected, const int width, const int height,
                          __global const float *depth_prev, bool *compared, bool *right) {
    const int x0 = (int)floor(px_prev.x - 0.5f), y0 = (int)floor(px_prev.y - 0.5f);
    float nearest = INFINITY, farthest = 0.0f;
    bool any_sky = false, all_sky = true;
#pragma unroll 1
    for (int tap = 0; tap < 4; ++tap) {
        const int x = clamp(x0 + (tap & 1), 0, width - 1), y = clamp(y0 + (tap >> 1), 0, height - 1);
        const float z = depth_prev[y * width + x];
        any_sky |= isinf(z) && z > 0.0f;
        all_sky &= isinf(z) && z > 0.0f;
        if (INVALID_DEPTH(z)) continue;
        nearest = fmin(nearest, z);
        farthest = fmax(farthest, z);
    }
    *compared = !(isinf(expected) && all_sky);  /* sky is everywhere the same */
    *right = isinf(expected)
                 ? any_sky
                 : nearest <= expected * (1.0f + DEPTH_AGREES) && farthest >= expected * (1.0f - DEPTH_AGREES);
}

/* Counts one sample of a row. `camera_step`: world units that the camera has moved; it has passed nearer surfaces. */
INLINE void count_sample(const int column, const int row, const int source_width, const int source_height,
                         const float camera_step, const Reprojection to_previous, __global const half *color,
                         __global const float *depth, __global const float2 *motion, __global const half *color_prev,
                         __global const float *depth_prev, __local int *found) {
    const int columns = min(source_width, SAMPLES_X), rows = min(source_height, SAMPLES_Y);
    const int x = (2 * column + 1) * source_width / (2 * columns), y = (2 * row + 1) * source_height / (2 * rows);
    const float z = column < columns && row < rows ? depth[y * source_width + x] : -1.0f;
    if (!INVALID_DEPTH(z)) {
        atomic_inc(found + VALID);
        if (z < camera_step) atomic_inc(found + PASSED);
        const float2 px = pixel_center(x, y), mv_px = motion[y * source_width + x], px_prev = px + mv_px;
        if (holds(source_width, source_height, px_prev)) {
            atomic_inc(found + INSIDE);
            bool compared, right;
            compare_depth(px_prev, depth_before(px, px_prev, mv_px, z, to_previous), source_width, source_height,
                          depth_prev, &compared, &right);
            if (compared) atomic_inc(found + COMPARED);
            if (compared && right) atomic_inc(found + DEPTH_RIGHT);
            const int x_prev = (int)px_prev.x, y_prev = (int)px_prev.y;
            const bool arms =
                has_arms(x, y, source_width, source_height) && has_arms(x_prev, y_prev, source_width, source_height);
#pragma unroll 1
            for (int axis = 0; axis < 2 && compared && right && arms; ++axis) {
                const int dx = axis ? 0 : ARM, dy = axis ? ARM : 0;
                const float now = contrast(color, x, y, dx, dy, source_width);
                const float before = contrast(color_prev, x_prev, y_prev, dx, dy, source_width);
                const float most = fmax(fabs(now), fabs(before));
                if (!(most > CONTRAST_LEAST)) continue;
                atomic_inc(found + WITH_CONTRAST);
                if (fabs(now - before) <= CONTRAST_AGREES * most) atomic_inc(found + CONTRAST_RIGHT);
            }
        }
    }
}
