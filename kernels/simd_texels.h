/* LANES texels of half images at once, wherever they lie, and cubic interpolation at LANES places. */

#include "cubic.h"

/* float4 of each lane, as they lie in memory -> channels. */
INLINE Wide4 channels_in(const float *texels) {
    Strip s;
    for (int part = 0; part < PARTS; ++part) s.part[part] = reload_texels(part, texels);
    return channels_of(&s);
}

/* Texels x to x + 3 of a row; beyond the image its border is repeated. */
INLINE float16 four_texels(__global const half *image, const int x, const int y, const int width, const int height) {
    const int row = clamp(y, 0, height - 1) * width;
    if (x >= 0 && x + 4 <= width) return load_four_texels(row + x, image);
    return (float16)(load_texel(row + clamp(x, 0, width - 1), image),
                     load_texel(row + clamp(x + 1, 0, width - 1), image),
                     load_texel(row + clamp(x + 2, 0, width - 1), image),
                     load_texel(row + clamp(x + 3, 0, width - 1), image));
}

/* Two of them. */
INLINE float8 two_texels(__global const half *image, const int x, const int y, const int width, const int height) {
    const int row = clamp(y, 0, height - 1) * width;
    if (x >= 0 && x + 2 <= width) return load_two_texels(row + x, image);
    return (float8)(load_texel(row + clamp(x, 0, width - 1), image),
                    load_texel(row + clamp(x + 1, 0, width - 1), image));
}

/* The image at LANES places of the lanes in `use` (others: 0), cubic without corners, clamped to the four inner
   taps. Of finite numbers. */
INLINE Wide4 cubic_at(const Ints use, const Floats px_x, const Floats px_y, const int width, const int height,
                      const float slope, __global const half *image) {
    const Floats corner_x = (use ? px_x : (Floats)(0.5f)) - 0.5f, corner_y = (use ? px_y : (Floats)(0.5f)) - 0.5f;
    const Floats first_x = floor(corner_x), first_y = floor(corner_y);
    const Ints x = to_ints(first_x) - 1, y = to_ints(first_y) - 1;
    const Sharpening sharp = NO_EDGES(slope);
    Cubic cubic;
    cubic_between(corner_x - first_x, corner_y - first_y, sharp, &cubic);
    const Ints first = y * width + x;
    const Ints in_row =
        use & (first == ROWS_OF_PARTS(first)) & (x >= 0) & (y >= 0) & (x + 4 <= width) & (y + 4 <= height);
    float texels[4 * LANES];
#pragma unroll
    for (int part = 0; part < PARTS; ++part) {
        const int lane = part * TEXELS;
        if (LANES > 1 && ALL_OF_PART(in_row, part)) {
            const int at = int_of(&first, lane), columns[4] = {0, 1, 2, 3};
            const int rows[4] = {at, at + width, at + 2 * width, at + 3 * width};
            unload_texels(cubic_of_run(columns, rows, &cubic, part, image), part, texels);
            continue;
        }
        for (int k = lane; k < lane + TEXELS; ++k) {
            float4 c = (float4)(0.0f);
            if (int_of(&use, k)) { /* beyond the image its border is repeated */
                int columns[4], rows[4];
                for (int tap = 0; tap < 4; ++tap) {
                    columns[tap] = clamp(int_of(&x, k) + tap, 0, width - 1);
                    rows[tap] = clamp(int_of(&y, k) + tap, 0, height - 1) * width;
                }
                c = cubic_of_lane(columns, rows, &cubic, k, image);
            }
            vstore4(c, k, texels);
        }
    }
    return channels_in(texels);
}
