/* Finding of a user interface in the color: of what stays in place although vectors move it.

   A pixel gives evidence if its color is that of the same place in the frame before, while its vector leads elsewhere,
   and the same surface, there or where it comes to, has clearly another color. Over PAIRS pairs of frames, in which
   the place never changes, and with others around, that is a user interface.

   `evidence` counts the pairs that gave some, `given_mask` is the caller's, `mask` is 1 where the rendered pixel stays
   in place. */

#include "frame.h"

/* What set the thresholds: docs/guide.md, "A user interface". */
#define PAIRS 2            /* pairs of frames that must give evidence */
#define LEAST_MARKED 8            /* pixels with so many, of the 5x5 around, make a user interface */
#define MARKED_AROUND 2           /* px: of these 5x5 */
#define MOVES 0.6f         /* px: the least motion that shows whether a color moves */
/* Squared differences of the square roots of exposed colors, times 4: of 3/4 and of 16 steps of 8 bits. */
#define SAME 3.46e-5f
#define CLEAR 0.01575f
#define LINEAR_BELOW 0.0015f       /* exposed color below which display values are linear */
#define STAYING_DEPTH 0.1f    /* relative, of one surface in both frames and a motion apart */
#define STAYING_MOTION 0.25f  /* of its motion, of one surface a motion apart */

INLINE float3 exposed(__global const half *color, const int i, const float exposure) {
    const float3 c = load_color(color, i) * exposure;
    return c > 0.0f ? c : (float3)(0.0f);
}

/* Whether display values of all channels differ by no more than `most` says. */
INLINE bool is_within(const float3 a, const float3 b, const float most) {
    const float3 apart = a - b, square = apart * apart, limit = most * ((a > b ? a : b) + LINEAR_BELOW);
    return square.x <= limit.x && square.y <= limit.y && square.z <= limit.z;
}

/* The pixel at px; -1 beyond the image. */
INLINE int pixel_at(const float2 px, const int width, const int height) {
    return holds(width, height, px) ? (int)px.y * width + (int)px.x : -1;
}

SPARSE __kernel void count_evidence(__constant Frame *restrict frame, __global const half *color,
                                    __global const half *color_prev, __global const float *depth,
                                    __global const float *depth_prev, __global const float2 *motion,
                                    __global uchar *evidence) {
    const int width = frame->source_width, height = frame->source_height;
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height) return;
    const int i = y * width + x;
    const float exposure = frame->exposure;
    const float3 c = exposed(color, i, exposure);
    if (!frame->has_previous || !is_within(c, exposed(color_prev, i, exposure), SAME)) {
        evidence[i] = 0;
        return;
    }
    const float2 mv = motion[i];
    const float length = fmax(fabs(mv.x), fabs(mv.y)), z = depth[i];
    if (!(length >= MOVES) || evidence[i] == PAIRS) return;
    const int from = pixel_at(pixel_center(x, y) + mv, width, height);
    const int to = pixel_at(pixel_center(x, y) - mv, width, height);
    bool stays = false;
    if (from >= 0 && is_same_surface(depth_prev[from], z, STAYING_DEPTH * z))
        stays = !is_within(exposed(color_prev, from, exposure), c, CLEAR);
    if (!stays && to >= 0 && is_same_surface(depth[to], z, STAYING_DEPTH * z)) {
        const float2 apart = fabs(motion[to] - mv);
        if (fmax(apart.x, apart.y) <= STAYING_MOTION * length)
            stays = !is_within(exposed(color, to, exposure), c, CLEAR);
    }
    if (stays) ++evidence[i];
}

INLINE bool has_evidence(__global const uchar *evidence, const int x, const int y, const int width, const int height) {
    return inside(x, y, width, height) && evidence[y * width + x] == PAIRS;
}

/* A user interface covers its pixels and their neighbors, which its antialiased edges share. */
SPARSE __kernel void mark_user_interface(__constant Frame *restrict frame, __global const uchar *evidence,
                                         __global const uchar *given_mask, __global uchar *mask) {
    const int width = frame->source_width, height = frame->source_height;
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height) return;
    const int i = y * width + x;
    bool marked = (frame->has_overlays & FIXED_MASK) && given_mask[i];
    for (int near = 0; near < 9 && !marked; ++near) {
        const int near_x = x + near % 3 - 1, near_y = y + near / 3 - 1;
        if (!has_evidence(evidence, near_x, near_y, width, height)) continue;
        int count = 0;
        for (int dy = -MARKED_AROUND; dy <= MARKED_AROUND; ++dy)
            for (int dx = -MARKED_AROUND; dx <= MARKED_AROUND; ++dx)
                count += has_evidence(evidence, near_x + dx, near_y + dy, width, height);
        marked = count >= LEAST_MARKED;
    }
    mask[i] = marked;
}
