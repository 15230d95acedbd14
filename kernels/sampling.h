/* Sampling planes anywhere, LANES pixels at once: bilinear, borders repeated. */

#include "common.h"
#include "places.h"

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

INLINE Floats between_taps(const Floats a, const Floats b, const Floats c, const Floats d, const Sample *s) {
    return (1.0f - s->v) * ((1.0f - s->u) * a + s->u * b) + s->v * ((1.0f - s->u) * c + s->u * d);
}

INLINE Floats sampled(__global const float *plane, const Sample *s) {
    const Floats a = gather_floats(plane, s->tap), b = gather_floats(plane, s->tap + s->right);
    const Ints below = s->tap + s->down;
    const Floats c = gather_floats(plane, below), d = gather_floats(plane, below + s->right);
    return between_taps(a, b, c, d, s);
}

/* Samples of several planes: the taps of most lie `in_runs`, all of them in the image. */
typedef struct {
    Sample sample;
    Places taps;
    int width;
    bool in_runs;
} SampleRuns;

INLINE void find_sample_runs(const Floats x, const Floats y, const int width, const int height, SampleRuns *s) {
    find_sample(x, y, width, height, &s->sample);
    find_places(s->sample.tap, width + 1, width * height, &s->taps);
    s->width = width;
    s->in_runs = (s->taps.one || s->taps.two) && ALL((s->sample.right == 1) & (s->sample.down == width));
}

INLINE Floats sampled_by_runs(__global const float *plane, const SampleRuns *s) {
    if (!s->in_runs) return sampled(plane, &s->sample);
    const Floats a = floats_of_runs(plane, s->taps, 0), b = floats_of_runs(plane, s->taps, 1);
    const Floats c = floats_of_runs(plane, s->taps, s->width), d = floats_of_runs(plane, s->taps, s->width + 1);
    return between_taps(a, b, c, d, &s->sample);
}
