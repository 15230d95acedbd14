/* Surfaces of a rendered frame: which neighbouring pixels show one surface (for 'Warping' and the background). */

#include "common.h"

#define SURFACE_STEP 0.02f       /* relative step of inverse depth between neighbours of one surface ... */
#define SURFACE_CURVATURE 0.005f /* ... or relative deviation from the plane through them, where they are steeper */


inline float inverse_depth_at(const int x, const int y, const int source_width, const int source_height,
                              __global const float *depth) {
    if (!inside(x, y, source_width, source_height)) return -1.0f;
    const float z = depth[y * source_width + x];
    if (INVALID_DEPTH(z)) return -1.0f;
    return isinf(z) ? 0.0f : divide(1.0f, z);
}

/* Whether b, next to a, continues a's surface; a2 lies behind a, b2 behind b. Inverse depths, 0 sky, -1 none. */
inline bool continues(const float a2, const float a, const float b, const float b2) {
    if (a < 0.0f || b < 0.0f) return false;
    if (a == 0.0f || b == 0.0f) return a == b;
    const float size = fmax(a, b);
    if (fabs(a - b) <= SURFACE_STEP * size) return true;
    if (a2 > 0.0f && fabs((a - a2) - (b - a)) <= SURFACE_CURVATURE * size) return true;
    return b2 > 0.0f && fabs((b2 - b) - (b - a)) <= SURFACE_CURVATURE * size;
}

/* links: which of the four neighbours belong to the same surface and are equally static or dynamic. */
__kernel void link_surfaces(const int source_width, const int source_height, __global const float *depth,
                            __global const uchar *dynamic_mask, __global uchar *links) {
    const int src_x = get_global_id(0), src_y = get_global_id(1);
    if (src_x >= source_width || src_y >= source_height) return;
    const int src = src_y * source_width + src_x;
    const uchar own = dynamic_mask[src];
    const float a = inverse_depth_at(src_x, src_y, source_width, source_height, depth);
    float w[4][3];
    for (int k = 0; k < 4; ++k) {
        const int dx = k == 0 ? 1 : k == 2 ? -1 : 0, dy = k == 1 ? 1 : k == 3 ? -1 : 0;
        w[k][0] = inverse_depth_at(src_x + dx, src_y + dy, source_width, source_height, depth);
        w[k][1] = inverse_depth_at(src_x + 2 * dx, src_y + 2 * dy, source_width, source_height, depth);
        w[k][2] = inside(src_x + dx, src_y + dy, source_width,
                         source_height) && dynamic_mask[src + dy * source_width + dx] == own ? 1.0f : 0.0f;
    }
    uchar bits = 0;
    for (int k = 0; k < 4; ++k)
        if (w[k][2] != 0.0f && continues(w[(k + 2) & 3][0], a, w[k][0], w[k][1])) bits |= 1 << k;
    links[src] = bits;
}
