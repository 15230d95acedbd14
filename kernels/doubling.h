/* Between an image and one of half its size, LANES pixels at once: bilinear interpolation up, means over 2x2 pixels
   down. Pixel centers of both lie on one plane; borders are repeated. */

#include "common.h"
#include "simd.h"

/* The four taps, in an image of `width` by `height` pixels, of LANES pixels of one of twice the size. `inner`: those to
   the left and to the right are in 8 pixels from `first` on, else `left` and `right`. */
typedef struct {
    int top, bottom, first;
    Ints left, right;
    Floats u;
    float v;
    bool inner;
} Taps;

/* Those of pixels in some `columns` of row y. */
INLINE void taps_of(const Ints columns, const int y, const int width, const int height, Taps *t) {
    const Ints x0 = (columns - 1) >> 1;
    const int y0 = (y - 1) >> 1;
    t->top = max(y0, 0) * width;
    t->bottom = min(y0 + 1, height - 1) * width;
    t->first = 0;
    t->left = clamp(x0, (Ints)(0), (Ints)(width - 1));
    t->right = min(x0 + 1, (Ints)(width - 1));
    t->u = (columns & 1) == 1 ? (Floats)(0.25f) : (Floats)(0.75f);
    t->v = (y & 1) ? 0.25f : 0.75f;
    t->inner = false;
}

/* Those of pixels from (x, y) on; x is a multiple of LANES. */
INLINE void taps_around(const int x, const int y, const int width, const int height, Taps *t) {
    taps_of(x + LANE_NUMBERS, y, width, height, t);
    t->first = (x >> 1) - 1;
    t->inner = LANES > 1 && t->first >= 0 && t->first + LANES <= width;
}

/* Bilinear interpolation of a plane. */
INLINE Floats interpolate(__global const float *plane, const Taps *t) {
    Floats a, b, c, d;
    if (t->inner) {
        __global const float *top = plane + t->top + t->first, *bottom = plane + t->bottom + t->first;
        a = load_left_taps(top);
        b = load_right_taps(top);
        c = load_left_taps(bottom);
        d = load_right_taps(bottom);
    } else {
        a = gather_floats(plane + t->top, t->left);
        b = gather_floats(plane + t->top, t->right);
        c = gather_floats(plane + t->bottom, t->left);
        d = gather_floats(plane + t->bottom, t->right);
    }
    const Floats u = t->u;
    const float v = t->v;
    return (1.0f - u) * (1.0f - v) * a + u * (1.0f - v) * b + (1.0f - u) * v * c + u * v * d;
}

/* The 2x2 pixels of a plane `width` pixels wide, which is even, for LANES pixels of a row from (x, y) on, of which the
   image of half the size has `count`: upper left and right, lower left and right. */
INLINE void load_quads(__global const float *plane, const int width, const int x, const int y, const int count,
                       Floats *part) {
    __global const float *top = plane + 2 * y * width + 2 * x;
    part[0] = load_some_xy(count, (__global const float2 *)top, &part[1]);
    part[2] = load_some_xy(count, (__global const float2 *)(top + width), &part[3]);
}

INLINE Floats mean_of_quad(const Floats *part) { return 0.25f * ((part[0] + part[1]) + (part[2] + part[3])); }

/* Means over 2x2 pixels, as above. */
INLINE Floats halved(__global const float *plane, const int width, const int x, const int y, const int count) {
    Floats part[4];
    load_quads(plane, width, x, y, count, part);
    return mean_of_quad(part);
}
