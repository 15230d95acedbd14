/* Levels of the background (background.cl collects them, projection.cl shows them). Level l has ceil(W / 2^l) x
   ceil(H / 2^l) texels over the rendered image. A texel holds one fragment: its color, its view depth and its pixel
   position (not the texel's center) in the camera of the frame for which the level was collected. What is SHOWN is not
   stored: it is that frame's own pixel. Level 0 remembers what movers hide, the next one what static surfaces hide.
   Stored positions are two 16-bit offsets from the texel's center, x in the lower half, in PX_UNITS of the texel's
   side: that holds what TOUCHES it. Stored colors are RGB9E5. */

#include "frame.h"
#include "simd.h"
#include "rgb9e5.h"
#include "color_code.h"

/* What set the threshold: docs/deviations.md, "Fragments must be deeper by a margin (case 2)". */
#define SAME_LEVEL 0.02f /* relative depth within which two fragments may be of the same surface */
#define PX_UNITS 32768.0f       /* of a stored position, per side of a texel */

/* The levels lie one after another: `starts` are the first texels of levels 1 to 3, and the end. */
INLINE int level_of(const int texel, const int4 starts) {
    return (texel >= starts.x) + (texel >= starts.y) + (texel >= starts.z);
}

INLINE int start_of(const int level, const int4 starts) {
    return level == 0 ? 0 : level == 1 ? starts.x : level == 2 ? starts.y : level == 3 ? starts.z : starts.w;
}

INLINE int size_of(const int level, __constant Frame *frame) {
    return level_side(frame->source_width, level) * level_side(frame->source_height, level);
}

/* Texels of a level, or of all, to read, and the frame whose pixels are those that are SHOWN. */
typedef struct {
    __global const uint *color;
    __global const half *frame_color;
    __global const float *depth, *frame_depth;
    __global const int *px;
    __global const uchar *state;
    int level, width;  /* of that level, or of the one that is read now */
} Texels;

/* The depth of the SHOWN fragment of a texel, or of the REMEMBERED one. */
INLINE float depth_of(const Texels t, const int texel, const bool shown) {
    return shown ? t.frame_depth[texel] : t.depth[texel];
}

/* `texel` is at (x, y) of its level. */
INLINE float2 px_of(const Texels t, const int texel, const int x, const int y, const bool shown) {
    const float2 center = pixel_center(x, y) * (float)(1 << t.level);
    if (shown) return center;
    const int packed = t.px[texel];
    return center + (float2)((float)((packed << 16) >> 16), (float)(packed >> 16)) * ((float)(1 << t.level) / PX_UNITS);
}

INLINE float3 code_of(const Texels t, const int texel, const bool shown, const float code_offset) {
    const float3 c = shown ? load_color(t.frame_color, texel) : unpack_color(t.color[texel]);
    return encode_color(c, code_offset);
}
