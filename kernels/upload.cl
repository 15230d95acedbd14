/* Colors from the host as other kernels take them, and counts of bad pixels. A work-item has LANES columns of ROWS rows, and counts
   in each column. */

#include "frame.h"
#include "simd_rgb.h"

#define ROWS 64  /* a byte holds the count of a column */

/* The columns of a work-item: their first pixel, the row after their last, how many there are, and where their counts are. */
typedef struct { int x, y, end, count, place, plane; } Columns;

inline void find_columns(const Frame frame, Columns *c) {
    const int width = frame.source_width, height = frame.source_height;
    c->x = get_global_id(0) * LANES;
    c->y = get_global_id(1) * ROWS;
    c->end = min(c->y + ROWS, height);
    c->count = c->y < height ? width - c->x : 0;
    c->place = (int)get_global_id(1) * width + c->x;
    c->plane = width * ((height + ROWS - 1) / ROWS);
}

/* Values of the host's array, which holds halves or floats. */
INLINE float given_value(__global const float *given, const bool halves, const int i) {
    return halves ? vload_half(i, (__global const half *)given) : given[i];
}

#if LANES == 8
INLINE float8 given_8(__global const float *given, const bool halves, const int i) {
    return halves ? vload_half8(0, (__global const half *)given + i) : vload8(0, given + i);
}

INLINE float16 given_16(__global const float *given, const bool halves, const int i) {
    return halves ? vload_half16(0, (__global const half *)given + i) : vload16(0, given + i);
}
#endif

/* LANES pixels from pixel i on, of which the image has `count` or more: RGB, and 0. */
INLINE void load_given(__global const float *given, const bool halves, const int channels, const int i, const int count, Strip *s) {
#if LANES == 8
    if (count >= LANES && channels == 4) {
        for (int part = 0; part < PARTS; ++part) {
            s->part[part] = given_16(given, halves, 4 * i + 16 * part);
            s->part[part].s37bf = 0.0f;
        }
        return;
    }
    if (count >= LANES) {
        const float16 a = given_16(given, halves, 3 * i);
        const float8 b = given_8(given, halves, 3 * i + 16);
        s->part[0] = (float16)(a.s012, 0.0f, a.s345, 0.0f, a.s678, 0.0f, a.s9ab, 0.0f);
        s->part[1] = (float16)(a.scde, 0.0f, a.sf, b.s01, 0.0f, b.s234, 0.0f, b.s567, 0.0f);
        return;
    }
#endif
    float texels[4 * LANES];
    for (int k = 0; k < LANES; ++k) {
        const int first = channels * (i + min(k, count - 1));
        for (int c = 0; c < 3; ++c) texels[4 * k + c] = given_value(given, halves, first + c);
        texels[4 * k + 3] = 0.0f;
    }
    for (int part = 0; part < PARTS; ++part) s->part[part] = reload_texels(part, texels);
}

/* NaN counts as 0; infinities and what half does not hold are clamped. */
INLINE void take(const Frame frame, __global const float *given, const bool halves, const int channels, __global half *color,
                 __global uchar *bad_pixels) {
    Columns columns;
    find_columns(frame, &columns);
    if (columns.count <= 0) return;
    const Ints none = 0, one = 1;
    Ints infinite = none, clamped = none;
    for (int y = columns.y; y < columns.end; ++y) {
        const int i = y * frame.source_width + columns.x;
        Strip s;
        load_given(given, halves, channels, i, columns.count, &s);
        bool good = true;
        for (int part = 0; part < PARTS; ++part) good &= ALL_TEXELS(fabs(s.part[part]) <= COLOR_MAX);
        if (!good) {
            Floats rgba[4];
            channels_of(&s, rgba);
            const Ints r = isfinite(rgba[0]), g = isfinite(rgba[1]), b = isfinite(rgba[2]);
            const Ints over = (r & (fabs(rgba[0]) > COLOR_MAX)) | (g & (fabs(rgba[1]) > COLOR_MAX)) | (b & (fabs(rgba[2]) > COLOR_MAX));
            infinite += (r & g & b) ? none : one;
            clamped += over ? one : none;
            for (int part = 0; part < PARTS; ++part) s.part[part] = finite_texels(s.part[part]);
        }
        store_strip(s, columns.count, color + 4 * i);
    }
    store_some_bytes(to_bytes(infinite), columns.count, bad_pixels + columns.place);
    store_some_bytes(to_bytes(clamped), columns.count, bad_pixels + columns.plane + columns.place);
}

WIDE __kernel void take_floats(const Frame frame, __global const float *given, const int channels, __global half *color,
                               __global uchar *bad_pixels) {
    take(frame, given, false, channels, color, bad_pixels);
}

WIDE __kernel void take_halves(const Frame frame, __global const half *given, const int channels, __global half *color,
                               __global uchar *bad_pixels) {
    take(frame, (__global const float *)given, true, channels, color, bad_pixels);
}

/* Depth that is NaN or not positive, motion that is NaN or infinite. */
WIDE __kernel void count_geometry(const Frame frame, __global const float *depth, __global const float2 *motion,
                                  __global uchar *bad_pixels) {
    Columns columns;
    find_columns(frame, &columns);
    if (columns.count <= 0) return;
    const Ints none = 0, one = 1;
    Ints bad_depth = none, bad_motion = none;
    for (int y = columns.y; y < columns.end; ++y) {
        const int i = y * frame.source_width + columns.x;
        Floats motion_y;
        const Floats z = load_some_floats(columns.count, depth + i), motion_x = load_some_xy(columns.count, motion + i, &motion_y);
        bad_depth += z > 0.0f ? none : one;
        bad_motion += (isfinite(motion_x) & isfinite(motion_y)) ? none : one;
    }
    store_some_bytes(to_bytes(bad_depth), columns.count, bad_pixels + 2 * columns.plane + columns.place);
    store_some_bytes(to_bytes(bad_motion), columns.count, bad_pixels + 3 * columns.plane + columns.place);
}
