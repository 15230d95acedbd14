/* LANES pixels of an image and their surroundings. */

#include "simd_rgb.h"

/* LANES pixels of an image from (x, y) on. `inner`: those around lie inside, too; else they are clamped to it. */
typedef struct {
    int x, y, width, height;
    bool inner;
} Span;

INLINE Span span_at(const int x, const int y, const int width, const int height) {
    const Span p = {x, y, width, height, x >= 1 && y >= 1 && x + LANES < width && y + 1 < height};
    return p;
}

/* Whether the pixels (dx, dy) from them are in the image, where these are; if not all, the nearest that are. */
INLINE Ints is_inside(const Span p, const int dx, const int dy) {
    if (p.inner) return ALL_LANES;
    const Ints x = p.x + dx + LANE_NUMBERS, y = (Ints)(p.y + dy);
    return (x >= 0) & (x < p.width) & (y >= 0) & (y < p.height);
}

INLINE int first_beside(const Span p, const int dx, const int dy) { return (p.y + dy) * p.width + p.x + dx; }

INLINE Ints clamped_beside(const Span p, const int dx, const int dy) {
    return clamp(p.y + dy, 0, p.height - 1) * p.width + clamp(p.x + dx + LANE_NUMBERS, (Ints)(0), (Ints)(p.width - 1));
}

INLINE Floats beside(const Span p, __global const float *plane, const int dx, const int dy) {
    return p.inner ? load_floats(0, plane + first_beside(p, dx, dy)) : gather_floats(plane, clamped_beside(p, dx, dy));
}

INLINE Bytes run_beside(const Span p, __global const uchar *plane, const int dx, const int dy) {
    return p.inner ? load_bytes(0, plane + first_beside(p, dx, dy)) : gather_bytes(plane, clamped_beside(p, dx, dy));
}

INLINE Ints bytes_beside(const Span p, __global const uchar *plane, const int dx, const int dy) {
    return to_ints(run_beside(p, plane, dx, dy));
}

INLINE Floats xy_beside(const Span p, __global const float2 *plane, const int dx, const int dy, Floats *y) {
    if (p.inner) return load_xy(plane + first_beside(p, dx, dy), y);
    const Ints i = 2 * clamped_beside(p, dx, dy);
    *y = gather_floats((__global const float *)plane, i + 1);
    return gather_floats((__global const float *)plane, i);
}

/* Texels of a half image, unchecked. */
INLINE void texels_beside(const Span p, __global const half *image, const int dx, const int dy, Strip *c) {
    if (!p.inner) {
        gather_strip(image, clamped_beside(p, dx, dy), c);
        return;
    }
#pragma unroll
    for (int part = 0; part < PARTS; ++part) c->part[part] = load_texels(part, image + 4 * first_beside(p, dx, dy));
}

/* Colors without negative values and NaN, and 1 as a fourth channel. */
INLINE void colors_beside(const Span p, __global const half *color, const int dx, const int dy, Strip *c) {
    Strip all;
    texels_beside(p, color, dx, dy, &all);
#pragma unroll
    for (int part = 0; part < PARTS; ++part) {
        const Texels low = all.part[part] > 0.0f ? all.part[part] : (Texels)(0.0f);
        c->part[part] = low < COLOR_MAX ? low : (Texels)(COLOR_MAX);
        VALID(c->part[part]) = 1.0f;
    }
}
