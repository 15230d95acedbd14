/* Flow, which is where source pixels go: predicted positions and their slopes (warp.cl, backward_blocks.cl), of LANES
   fragments at once. */

#include "frame.h"
#include "places.h"

/* What set the thresholds: docs/deviations.md, "Fragments cover what their pixel maps to". */
#define FOOTPRINT_HALF 0.65f /* half a source pixel and a margin for second-order terms */
#define FOOTPRINT_REACH 8 /* px: the most that a fragment covers to each side */
#define STRETCH_MOST 4.0f /* a footprint stretched by more than this over the one by depth is not trusted */

/* Predicted position of fragment `src`: (px in the target image, view depth there). */
INLINE float3 position_of(__global const float *target_position, const int src, const int plane) {
    return (float3)(target_position[src], target_position[plane + src], target_position[2 * plane + src]);
}

/* Fragments of the rendered frame, and the image that they go to. */
typedef struct {
    __global const float *depth;           /* in the rendered frame */
    __global const float *target_position; /* planes of x, y (px) and depth in the new one */
    __global const uchar *links;           /* to neighbors of the same surface; none leaves the image */
    int width, height, plane;              /* of the rendered frame; plane: its pixels */
    int target_width, target_height;
    float2 zoom; /* target pixels per source pixel of points equally far from both cameras */
} Fragments;

INLINE Fragments fragments_of(__constant Frame *frame, __global const float *depth,
                              __global const float *target_position, __global const uchar *links) {
    const int width = frame->source_width, height = frame->source_height;
    const Fragments f = {
        depth,      target_position, links, width, height, width * height, frame->target_width, frame->target_height,
        frame->zoom};
    return f;
}

/* The values of one plane at LANES fragments and at their neighbors. */
typedef struct {
    Floats here, left, right, up, down;
} Cross;

INLINE void load_cross_of_run(__global const float *p, const int source_width, Cross *a) {
    a->here = load_floats(0, p);
    a->left = load_floats(0, p - 1);
    a->right = load_floats(0, p + 1);
    a->up = load_floats(0, p - source_width);
    a->down = load_floats(0, p + source_width);
}

INLINE void load_cross(__global const float *plane, const int source_width, const Places src, Cross *a) {
    if (src.one) {
        load_cross_of_run(plane + src.first, source_width, a);
    } else if (src.two) {
        Cross b;
        load_cross_of_run(plane + src.first, source_width, a);
        load_cross_of_run(plane + src.last, source_width, &b);
        a->here = src.of_last ? b.here : a->here;
        a->left = src.of_last ? b.left : a->left;
        a->right = src.of_last ? b.right : a->right;
        a->up = src.of_last ? b.up : a->up;
        a->down = src.of_last ? b.down : a->down;
    } else {
        const Ints left = stepped(src, -1), right = stepped(src, 1), up = stepped(src, -source_width),
                   down = stepped(src, source_width);
        a->here = gather_floats(plane, src.at);
        a->left = gather_floats(plane, left);
        a->right = gather_floats(plane, right);
        a->up = gather_floats(plane, up);
        a->down = gather_floats(plane, down);
    }
}

/* Predicted positions of LANES fragments and of their neighbors; beyond the image's border of any others. */
typedef struct {
    Cross x, y, z;
} Positions;

INLINE void load_positions(const Fragments f, const Places src, Positions *p) {
    load_cross(f.target_position, f.width, src, &p->x);
    load_cross(f.target_position + f.plane, f.width, src, &p->y);
    load_cross(f.target_position + 2 * f.plane, f.width, src, &p->z);
}

/* Target positions as linear functions of source positions around LANES fragments: change of (x, y, z) per source pixel
   to the right and down, and the determinant of the 2x2 part, in target px^2 per source px^2. */
typedef struct {
    Floats xx, xy, xz, yx, yy, yz, det;
} WideFlow;

/* Change of a coordinate from those of the neighbors `before` and `after` that are used. */
INLINE Floats wide_slope(const Floats before, const Floats here, const Floats after, const Ints use_before,
                         const Ints use_after) {
    const Floats sum = (use_after ? after - here : (Floats)(0.0f)) + (use_before ? here - before : (Floats)(0.0f));
    return (use_before & use_after) ? sum * 0.5f : sum;
}

/* The flow at LANES fragments, from their linked neighbors; along a direction without any, from depth alone. `bits`:
   links. */
INLINE void wide_flow(const Positions at, const Ints bits, const Floats z_source, const float2 zoom, WideFlow *flow) {
    const Cross x = at.x, y = at.y, z = at.z;
    const Ints left = ((bits & LINK_LEFT) != 0) & (z.left > 0.0f),
               right = ((bits & LINK_RIGHT) != 0) & (z.right > 0.0f);
    const Ints up = ((bits & LINK_UP) != 0) & (z.up > 0.0f), down = ((bits & LINK_DOWN) != 0) & (z.down > 0.0f);
    const Ints sky = isinf(z.here);
    const Floats none = (Floats)(0.0f);
    WideFlow f;
    f.xx = wide_slope(x.left, x.here, x.right, left, right);
    f.xy = wide_slope(y.left, y.here, y.right, left, right);
    f.xz = sky ? none : wide_slope(z.left, z.here, z.right, left, right);
    f.yx = wide_slope(x.up, x.here, x.down, up, down);
    f.yy = wide_slope(y.up, y.here, y.down, up, down);
    f.yz = sky ? none : wide_slope(z.up, z.here, z.down, up, down);
    const Floats nearer = (sky | ((bits & IN_LATTICE) != 0)) ? (Floats)(1.0f) : wide_divide(z_source, z.here);
    const Floats scale_x = zoom.x * nearer, scale_y = zoom.y * nearer;
    const Floats most = STRETCH_MOST * (scale_x > scale_y ? scale_x : scale_y);
    const Ints known_x = (left | right) & !(fabs(f.xx) > most) & !(fabs(f.xy) > most);
    const Ints known_y = (up | down) & !(fabs(f.yx) > most) & !(fabs(f.yy) > most);
    f.xx = known_x ? f.xx : scale_x;
    f.xy = known_x ? f.xy : none;
    f.yx = known_y ? f.yx : none;
    f.yy = known_y ? f.yy : scale_y;
    const Floats det = f.xx * f.yy - f.yx * f.xy;
    /* Else folded or edge-on: the neighbors do not determine the footprint. */
    const Ints open = det > 0.02f * scale_x * scale_y;
    f.xx = open ? f.xx : scale_x;
    f.xy = open ? f.xy : none;
    f.xz = (open & known_x) ? f.xz : none;
    f.yx = open ? f.yx : none;
    f.yy = open ? f.yy : scale_y;
    f.yz = (open & known_y) ? f.yz : none;
    f.det = open ? det : scale_x * scale_y;
    *flow = f;
}
