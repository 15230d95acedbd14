/* Sampling planes anywhere, LANES pixels at once: bilinear, borders repeated. */

#include "common.h"
#include "simd.h"

/* Column of each lane's pixel. */
INLINE Floats row_indices(const int x) { return to_floats(x + LANE_NUMBERS); }

/* The taps around positions in pixels, with whole numbers at pixel centers. NaN counts as the far border. */
typedef struct {
    Ints tap, right, down;
    Floats u, v;
} Sample;

INLINE void find_sample(const Floats x, const Floats y, const int width, const int height, Sample *s) {
    const Floats px = wide_greater(wide_lesser(x, (Floats)((float)(width - 1))), (Floats)(0.0f));
    const Floats py = wide_greater(wide_lesser(y, (Floats)((float)(height - 1))), (Floats)(0.0f));
    const Ints x0 = to_ints(px), y0 = to_ints(py);
    s->tap = y0 * width + x0;
    s->right = x0 < width - 1 ? (Ints)(1) : (Ints)(0);
    s->down = y0 < height - 1 ? (Ints)(width) : (Ints)(0);
    s->u = px - to_floats(x0);
    s->v = py - to_floats(y0);
}

INLINE Floats sampled(__global const float *plane, const Sample *s) {
    const Floats a = gather_floats(plane, s->tap), b = gather_floats(plane, s->tap + s->right);
    const Ints below = s->tap + s->down;
    const Floats c = gather_floats(plane, below), d = gather_floats(plane, below + s->right);
    return (1.0f - s->v) * ((1.0f - s->u) * a + s->u * b) + s->v * ((1.0f - s->u) * c + s->u * d);
}
