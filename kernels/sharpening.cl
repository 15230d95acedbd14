/* Contrast-adaptive sharpening of upscaled frames.

   Each pixel moves away from its four neighbors, the less the more these differ already: k is (strength / 5) low / high
   of their luma over what it takes away from itself. Flat places and noise of equal share look alike in the dark and in
   the light, so no exposure is needed; beside strong edges there is next to no overshoot.

   name        image     what in         color       display   linear: the history, or the generated frame out
   out_color   display   sharpened */

#include "frame.h"
#include "stencil.h"
#include "simd_texels.h"

INLINE Floats luma_of(const Strip *s) {
    Floats c[4];
    channels_of(s, c);
    return 0.25f * (c[0] + c[2]) + 0.5f * c[1];
}

WIDE __kernel void sharpen(__constant Frame *restrict frame, __global const half *color, __global half *out_color) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const float upscale_sharpening = frame->upscale_sharpening;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), i = y * target_width + x, count = target_width - x;
    if (x >= target_width || y >= target_height) return;
    const Span p = {x, y, target_width, target_height,
                    x >= 1 && y >= 1 && x + LANES < target_width && y + 1 < target_height};
    Strip own, sum;
    texels_beside(p, color, 0, 0, &own);
    Floats low = luma_of(&own), high = low;
#pragma unroll
    for (int k = 0; k < 4; ++k) {
        Strip c;
        texels_beside(p, color, (k == 1) - (k == 2), (k == 3) - (k == 0), &c);
        const Floats luma = luma_of(&c);
        low = wide_lesser(low, luma);
        high = wide_greater(high, luma);
#pragma unroll
        for (int part = 0; part < PARTS; ++part) sum.part[part] = k ? sum.part[part] + c.part[part] : c.part[part];
    }
    const Floats less = upscale_sharpening * low;
    const Floats amount = wide_divide(less, wide_greater(5.0f * high - 4.0f * less, (Floats)(1e-6f)));
#pragma unroll
    for (int part = 0; part < PARTS; ++part) {
        const Texels c = own.part[part] + OF_TEXELS(amount, part) * (4.0f * own.part[part] - sum.part[part]);
        const Texels raised = c > 0.0f ? c : (Texels)(0.0f);
        own.part[part] = raised < COLOR_MAX ? raised : (Texels)(COLOR_MAX);
        VALID(own.part[part]) = 0.0f;
    }
    store_strip(own, count, out_color + 4 * i);
}
