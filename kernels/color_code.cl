/* Codes of the rendered frame's colors, for all who mix them. */

#include "frame.h"
#include "simd_rgb.h"
#include "blocks.h"
#include "color_code.h"

DEFINE_ROOT(Texels, texel_roots)

/* encode_texels is encode_color of pixels of a strip. */
DEFINE_COLOR_CODE(Texels, texel_roots, encode_texels, decode_texels)

/* Whether a block and those around it are COPIED, where source and target have the same blocks: then nobody mixes its
   colors. */
INLINE bool is_unmixed(const int bx, const int by, const int columns, const int rows,
                       __global const uchar *block_class) {
    for (int y = max(by - 1, 0); y <= min(by + 1, rows - 1); ++y)
        for (int x = max(bx - 1, 0); x <= min(bx + 1, columns - 1); ++x)
            if (block_class[y * columns + x] != COPIED) return false;
    return true;
}

/* NaN counts as 0, infinities are clamped. Once for all new frames that are made of a rendered one; but under a camera
   that stays only colors that may be mixed. BLOCK_HEIGHT rows of LANES pixels per work-item. */
WIDE __kernel void encode_colors(__constant Frame *restrict frame, __global const half *color,
                                 __global const uchar *block_class, __global half *codes) {
    const int width = frame->source_width, height = frame->source_height;
    const int src_x = get_global_id(0) * LANES, by = get_global_id(1), count = width - src_x;
    if (src_x >= width || by * BLOCK_HEIGHT >= height || frame->coded) return;
    if (frame->stays && is_unmixed(src_x / BLOCK_WIDTH, by, block_columns(width), block_rows(height), block_class))
        return;
    for (int src_y = by * BLOCK_HEIGHT; src_y < min((by + 1) * BLOCK_HEIGHT, height); ++src_y) {
        const int src = src_y * width + src_x;
        Strip s = load_strip(count, color + 4 * src);
        for (int part = 0; part < PARTS; ++part)
            s.part[part] = encode_texels(finite_texels(s.part[part]), frame->code_offset);
        store_strip(s, count, codes + 4 * src);
    }
}
