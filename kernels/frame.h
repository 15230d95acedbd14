/* The frame block: the arguments of kernels for a frame, besides its buffers. gffe_cl/engine/stages/frame_block.py
   reads this struct and fills it for each rendered and each extrapolated frame; `gffe export` makes the same struct
   in C. Kernels take it as `restrict`: CPUs then read it once for all work-items of a group, since no store can change
   it. Functions do not: Oclgrind fails on what comes of that once they are inlined. The widest types come first:
   nothing is padded. Where there is no frame before, "previous" is the rendered frame itself; what is about the target
   is 0 while stages work on a rendered frame. */

#include "common.h"

#define MOST_RESTS 3 /* as long as any kernel looks back */
#define MAX_ORDER 5   /* of prediction */
#define WEIGHT_ROWS 4 /* of four numbers each: MAX_ORDER (MAX_ORDER + 1) / 2 in all */
#define MAX_LEVELS 4  /* of the background */

typedef struct {
    Reprojection to_previous; /* source -> previous */
    Reprojection from_previous; /* previous -> source */
    Reprojection to_target; /* source -> target */
    Reprojection to_source; /* target -> source */
    Reprojection target_to_previous;
    /* The factors of P_1 - P_0 to P_o - P_0 in the polynomial of order o: of order 1, then of order 2, and so on. */
    float4 polynomial[WEIGHT_ROWS];
    float4 color_law; /* mu_law.h, at this frame's exposure */
    float4 to_render; /* display -> source: scale x, y, offset x, y in pixels */
    float4 to_display; /* source -> display */
    float4 to_previous_display; /* previous -> its display */
    float4 given_motion; /* of an engine's buffers, for upload.cl: factors and addends of x and y, in stored numbers */
    float4 given_depth; /* of the same: factor, origin, addend, the value of sky */
    float4 to_geometry; /* color -> given depth and motion: scale x, y, offset x, y in pixels */
    float4 from_geometry; /* these -> color */
    int4 given_types; /* of color, depth, motion; and what vectors have of the camera's motion */
    int4 level_starts; /* first texels of background levels 1, 2 and 3, and the end of all levels */
    float2 zoom; /* target pixels per source pixel of points equally far from both cameras */
    float2 pixel_size; /* of the source, display pixels */
    int2 given_channels; /* of color and motion */
    int geometry_width, geometry_height; /* of given depth and motion */
    int source_width, source_height;
    int target_width, target_height;
    int network_width, network_height;
    int cells_width, cells_height; /* of the grid on which shading trends are measured */
    int has_previous;
    int number; /* of the rendered frame, since the stages were made; after 2^30 it starts again */
    int rests; /* intervals, up to MOST_RESTS, for which the rendered camera has been the same, to the bit */
    int stays; /* whether the new camera is the rendered one, and blocks at rest are copied */
    int coded; /* whether the rendered frame's colors are all encoded: by history tracking, or for another new frame */
    int order; /* of prediction: the option, or less if there are too few frames */
    float alpha;
    float interval_ratio; /* the last interval between rendered frames, in that before it */
    float exposure; /* factor on color before display */
    float code_offset; /* color_code.h, at this frame's exposure */
    float camera_step; /* world units that the camera moved since the frame before */
    float motion_invalid; /* the stored number of unwritten vectors; NaN: there is none */
    int depth_law; /* of given depth */
    int rows_up; /* whether the first rows of given buffers are the lowest ones */
    int color_srgb; /* whether given color is sRGB instead of linear */
    int has_overlays; /* that the rendered frame brings, in the order of the host's `OVERLAYS` */
    /* Facts: options, and decisions of stages at construction. */
    int motion; /* whether motion is estimated */
    int entering; /* whether movers that enter through the border go on as they came */
    int camera_fixed; /* whether fragments fixed to the camera are distinguished from movers */
    int positions; /* of history, that are kept */
    int levels; /* of the background */
    int blocks; /* whether smooth surfaces are warped backward in blocks */
    int crack_closing;
    int copies; /* whether blocks at rest may be copied */
    int softens; /* whether silhouettes are made soft */
    int bends; /* whether movers' acceleration continues */
    int far_side; /* whether holes continue their far side */
    int dilates; /* whether the dilated warp makes the new frame */
    int detects; /* whether samples are counted that tell a cut */
    int automatic; /* whether the static threshold follows from the frame */
    int sharpness; /* whether it is measured, and new frames are resampled with it */
    int lattices; /* whether blocks may move as one layer */
} Frame;

/* Bits of `has_overlays`. */
#define FIXED_MASK 1
#define EFFECTS 2
#define EFFECTS_MOTION 4
#define USER_INTERFACE 8

/* The side of an image of level `level`, whose texels are 2^level pixels wide and high. */
INLINE int level_side(const int side, const int level) { return (side + (1 << level) - 1) >> level; }

/* Values of `dynamic_mask`; all but STATIC are dynamic. */
#define STATIC 0
#define DYNAMIC 1
#define FIXED_TO_CAMERA 2 /* constant in view space, as dashboards and weapons are */

/* States of texels of the background, REMEMBERED last; none is 1, which Oclgrind makes 255 where vectors choose it. */
#define EMPTY 0
#define SHOWN 2 /* of level 0: a static fragment of the frame itself: the warp projects it */
#define EDGE 3 /* of level 0: static, beside a nearer static surface: neither SHOWN nor to be filled */
#define REMEMBERED 4 /* of an earlier frame */
