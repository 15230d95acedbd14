/* Codes of the rendered frame's colors, for all who mix them. */

#include "frame.h"
#include "simd_rgb.h"
#include "color_code.h"

DEFINE_ROOT(Texels, texel_roots)

/* encode_texels is encode_color of pixels of a strip. */
DEFINE_COLOR_CODE(Texels, texel_roots, encode_texels, decode_texels)

/* NaN counts as 0, infinities are clamped. */
WIDE __kernel void encode_colors(__constant Frame *restrict frame, __global const half *color, __global half *codes) {
    const int width = frame->source_width, src_x = get_global_id(0) * LANES, src_y = get_global_id(1),
              count = width - src_x;
    if (src_x >= width || src_y >= frame->source_height) return;
    const int src = src_y * width + src_x;
    Strip s = load_strip(count, color + 4 * src);
    for (int part = 0; part < PARTS; ++part)
        s.part[part] = encode_texels(finite_texels(s.part[part]), frame->code_offset);
    store_strip(s, count, codes + 4 * src);
}
