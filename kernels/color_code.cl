/* Codes of the rendered frame's colors, for all who mix them, where history tracking has left them out: while the
   camera rests. */

#include "frame.h"
#include "blocks.h"
#include "encode.h"

/* Whether a block and those around it are COPIED, where source and target have the same blocks: then nobody mixes its
   colors. */
INLINE bool is_unmixed(const int bx, const int by, const int columns, const int rows,
                       __global const uchar *block_class) {
    for (int y = max(by - 1, 0); y <= min(by + 1, rows - 1); ++y)
        for (int x = max(bx - 1, 0); x <= min(bx + 1, columns - 1); ++x)
            if (block_class[y * columns + x] != COPIED) return false;
    return true;
}

/* Once for all new frames of a rendered one; but under a camera that stays only colors that may be mixed. BLOCK_HEIGHT
   rows of LANES pixels per work-item. */
WIDE __kernel void encode_colors(__constant Frame *restrict frame, __global const half *color,
                                 __global const uchar *block_class, __global half *codes) {
    const int width = frame->source_width, height = frame->source_height;
    const int src_x = get_global_id(0) * LANES, by = get_global_id(1), count = width - src_x;
    if (src_x >= width || by * BLOCK_HEIGHT >= height || frame->coded) return;
    if (frame->stays && is_unmixed(src_x / BLOCK_WIDTH, by, block_columns(width), block_rows(height), block_class))
        return;
    for (int src_y = by * BLOCK_HEIGHT; src_y < min((by + 1) * BLOCK_HEIGHT, height); ++src_y)
        encode_run(count, src_y * width + src_x, frame->code_offset, color, codes);
}
