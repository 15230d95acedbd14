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

INLINE Floats between_taps(const Floats a, const Floats b, const Floats c, const Floats d, const Sample *s) {
    return (1.0f - s->v) * ((1.0f - s->u) * a + s->u * b) + s->v * ((1.0f - s->u) * c + s->u * d);
}

INLINE Floats sampled(__global const float *plane, const Sample *s) {
    const Floats a = gather_floats(plane, s->tap), b = gather_floats(plane, s->tap + s->right);
    const Ints below = s->tap + s->down;
    const Floats c = gather_floats(plane, below), d = gather_floats(plane, below + s->right);
    return between_taps(a, b, c, d, s);
}

/* Samples of several planes: the taps of most lie in rows but for one jump, which the ends tell. With in_runs, all of
   them are in the image, and each lane's first is in the run from `first` on, or, where in_second, from `second` on. */
typedef struct {
    Sample sample;
    int first, second, width;
    Ints in_second;
    bool in_runs;
} SampleRuns;

INLINE void find_sample_runs(const Floats x, const Floats y, const int width, const int height, SampleRuns *s) {
    find_sample(x, y, width, height, &s->sample);
#if LANES == 8
    const Ints tap = s->sample.tap, whole = (s->sample.right == 1) & (s->sample.down == width);
    s->width = width;
    s->first = FIRST_LANE(tap);
    s->second = max(LAST_LANE(tap) - (LANES - 1), 0);
    s->in_second = tap != s->first + LANE_NUMBERS;
    s->in_runs = max(s->first, s->second) + width + LANES < width * height
                 && ALL(whole & (!s->in_second | (tap == s->second + LANE_NUMBERS)));
#endif
}

#if LANES == 8
/* One tap of each lane, `step` after the first. */
INLINE Floats tap_of_runs(__global const float *plane, const SampleRuns *s, const int step) {
    const Floats first = load_floats(0, plane + s->first + step);
    return s->in_second ? load_floats(0, plane + s->second + step) : first;
}
#endif

INLINE Floats sampled_by_runs(__global const float *plane, const SampleRuns *s) {
#if LANES == 8
    if (s->in_runs) {
        const Floats a = tap_of_runs(plane, s, 0), b = tap_of_runs(plane, s, 1);
        const Floats c = tap_of_runs(plane, s, s->width), d = tap_of_runs(plane, s, s->width + 1);
        return between_taps(a, b, c, d, &s->sample);
    }
#endif
    return sampled(plane, &s->sample);
}
