/* Values of planes at LANES pixels anywhere, which mostly lie in a row, but for one jump. */

#include "simd.h"

/* In an image of `pixels`: `one` run from `first` on, or `two`, of which the other begins at `last`, or anywhere. */
typedef struct {
    Ints at, of_last;
    int first, last, pixels;
    bool one, two;
} Places;

/* `margin`: the number of pixels before and after a run that are read with it. */
INLINE void find_places(const Ints at, const int margin, const int pixels, Places *p) {
    p->at = at;
    p->pixels = pixels;
    p->first = FIRST_LANE(at);
    p->last = LAST_LANE(at) - (LANES - 1);
    const Ints of_first = at == p->first + LANE_NUMBERS;
    p->of_last = at == p->last + LANE_NUMBERS;
    const bool within =
        LANES > 1 && min(p->first, p->last) >= margin && max(p->first, p->last) + margin + LANES <= pixels;
    p->one = within && ALL(of_first);
    p->two = within && ALL(of_first | p->of_last);
}

/* The pixels `step` after these; any of the image where that leaves it. */
INLINE Ints stepped(const Places p, const int step) { return clamp(p.at + step, (Ints)(0), (Ints)(p.pixels - 1)); }

/* Values of `one` or `two` runs, `step` after these pixels; and of any. */
INLINE Floats floats_of_runs(__global const float *plane, const Places p, const int step) {
    const Floats first = load_floats(0, plane + (p.first + step));
    return p.of_last ? load_floats(0, plane + (p.last + step)) : first;
}

INLINE Floats floats_beside(__global const float *plane, const Places p, const int step) {
    if (p.one) return load_floats(0, plane + (p.first + step));
    if (p.two) return floats_of_runs(plane, p, step);
    return gather_floats(plane, stepped(p, step));
}

/* The places lie in the image. */
INLINE Floats floats_at(__global const float *plane, const Places p) {
    if (p.one) return load_floats(0, plane + p.first);
    return p.two ? floats_of_runs(plane, p, 0) : gather_floats(plane, p.at);
}

INLINE Bytes bytes_at(__global const uchar *plane, const Places p) {
    return p.one ? load_bytes(0, plane + p.first) : gather_bytes(plane, p.at);
}
