/* Codes of the rendered frame's colors (color_code.h), LANES of a row at once. */

#include "simd_rgb.h"
#include "color_code.h"

DEFINE_ROOT(Texels, texel_roots)
DEFINE_COLOR_CODE(Texels, texel_roots, ANY_TEXELS, encode_texels, decode_texels)

/* Encodes `count` colors, at most LANES, from pixel `src` on. NaN counts as 0, infinities are clamped. */
INLINE void encode_run(const int count, const int src, const float code_offset, __global const half *color,
                       __global half *codes) {
    Strip s = load_strip(count, color + 4 * src);
#pragma unroll
    for (int part = 0; part < PARTS; ++part) {
        VALID(s.part[part]) = 0.0f; /* before and after: so nothing is computed for it */
        s.part[part] = encode_texels(finite_texels(s.part[part]), code_offset);
        VALID(s.part[part]) = 0.0f;
    }
    store_strip(s, count, codes + 4 * src);
}
