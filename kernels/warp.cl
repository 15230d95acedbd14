/* Warp (paper: 'Warping', with crack closing and resampling). A fragment covers, in the target image, the
   parallelogram to which its own pixel maps; the nearest fragment keeps a target pixel, ties go to the smallest
   source index. Blocks that show one smooth surface (backward_blocks.cl) are neither splatted nor searched: their
   pixels come from the places that the inverse of the block's flow gives. */

#include "frame.h"
#include "resampling.h"
#include "nearest.h"
#include "flow.h"
#include "blocks.h"
#include "layers.h"
#include "lists.h"
#include "thresholds.h"

/* What set the thresholds: docs/deviations.md, "Color is resampled at its sub-pixel position", "No colors mixed with a
   silhouette that moves away". */
#define STILL 0.001f             /* px: less than this is rounding */
#define SAME_MOTION 0.5f         /* px: fragments that deviate less from the winner's motion are resampled with it */
#define MOVES_AWAY 1.0f          /* px: a nearer neighbor that deviates more uncovers the surface it was mixed with */

/* The nearest fragment of each target pixel so far: nearest.h. */
typedef struct {
    __global Key *keys;
    __global uint *winners;
} Winners;

/* The new frame. */
typedef struct {
    __global half *color;
    __global float *depth;
    __global float2 *motion;
    __global uchar *dynamic_mask, *disoccluded, *filled_by;
} NewFrame;

/* ---- splat --------------------------------------------------------------------------------------------------- */

/* Of the pixels that LANES fragments may cover, the first and the last column and row. */
typedef struct {
    Floats x0, y0, x1, y1;
} Boxes;

/* Which of 3x3 pixels each footprint covers: bit 3 (dy + 1) + dx + 1. (x, y): the corner of the middle one. */
INLINE Ints covered_tile(const Floats x, const Floats y, const Positions at, const WideFlow f) {
    const Floats limit = FOOTPRINT_HALF * f.det;
    Floats across_x[3], across_y[3], down_x[3], down_y[3]; /* place in the fragment, times det, by columns and rows */
    for (int k = 0; k < 3; ++k) {
        const Floats dx = (x + ((float)k - 0.5f)) - at.x.here, dy = (y + ((float)k - 0.5f)) - at.y.here;
        across_x[k] = f.yy * dx;
        across_y[k] = f.xy * dx;
        down_x[k] = f.yx * dy;
        down_y[k] = f.xx * dy;
    }
    Ints covers = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const Ints covered =
            (fabs(across_x[k % 3] - down_x[k / 3]) <= limit) & (fabs(down_y[k / 3] - across_y[k % 3]) <= limit);
        covers |= covered ? (Ints)(1 << k) : (Ints)(0);
    }
    return covers;
}

/* Which of the same pixels lie in the boxes. */
INLINE Ints tile_within(const Floats x, const Floats y, const Boxes box) {
    const Ints all_bits = (Ints)(0x1FF);
    Ints within = all_bits;
    for (int k = 0; k < 3; ++k) {
        const Floats column = x + (float)(k - 1), row = y + (float)(k - 1);
        within &= ((column >= box.x0) & (column <= box.x1)) ? all_bits : (Ints)(0x1FF & ~(0x49 << k));
        within &= ((row >= box.y0) & (row <= box.y1)) ? all_bits : (Ints)(0x1FF & ~(7 << 3 * k));
    }
    return within;
}

/* Offers LANES fragments, of which `src` is the first, to the pixels that they cover of 3x3, whose middle ones are
   `middle`. */
INLINE void offer_tile(const Ints covers, const Ints middle, const Floats z, const int src, const int width,
                       const Winners to, const int pass) {
    for (int lane = 0; lane < LANES; ++lane)
        for (int left = int_of(&covers, lane); left; left &= left - 1) {
            const int k = 31 - clz(left & -left), dy = (k * 11) >> 5, dx = k - 3 * dy;
            offer(pass, to.keys, to.winners, int_of(&middle, lane) + (dy - 1) * width + dx - 1, float_of(&z, lane),
                  (uint)(src + lane));
        }
}

/* Offers `count` fragments of a row to the pixels that they cover: most cover no more than the 3x3 around their own,
   the others some of such tiles side by side. */
INLINE void splat_fragments(const Fragments from, const Winners to, const int src, const int count,
                            const int crack_closing, const int pass) {
    const float width = (float)from.target_width, height = (float)from.target_height;
    const Floats none = (Floats)(0.0f), reach = (Floats)(FOOTPRINT_REACH);

    /* Where they go, and whether anything of them may land in the image. */
    Places places;
    find_places(src + min((Ints)(LANE_NUMBERS), (Ints)(count - 1)), from.width, from.plane, &places);
    Positions at;
    load_positions(from, places, &at);
    const Floats x = at.x.here, y = at.y.here, z = at.z.here, own_x = floor(x), own_y = floor(y);
    const Ints lands =
        (LANE_NUMBERS < count) & (z > 0.0f) & (x > -reach) & (y > -reach) & (x < width + reach) & (y < height + reach);
    if (!ANY(lands)) return;

    /* px to each side that they cover. */
    WideFlow f;
    wide_flow(at, to_ints(bytes_at(from.links, places)), floats_at(from.depth, places), from.zoom, &f);
    const Floats half_x = wide_lesser(FOOTPRINT_HALF * (fabs(f.xx) + fabs(f.yx)), reach),
                 half_y = wide_lesser(FOOTPRINT_HALF * (fabs(f.xy) + fabs(f.yy)), reach);
    /* To pixel centers, and a little for rounding. */
    const Floats margin_x = crack_closing ? half_x + 0.51f : none, margin_y = crack_closing ? half_y + 0.51f : none;
    const Boxes box = {wide_greater(ceil(x - margin_x), none), wide_greater(ceil(y - margin_y), none),
                       wide_lesser(floor(x + margin_x - 1.0f), (Floats)(width - 1.0f)),
                       wide_lesser(floor(y + margin_y - 1.0f), (Floats)(height - 1.0f))};
    const Ints own = (x >= 0.0f) & (y >= 0.0f) & (x < width) & (y < height); /* covered however small they are */
    const Floats most =
        wide_greater(wide_greater(own_x - box.x0, box.x1 - own_x), wide_greater(own_y - box.y0, box.y1 - own_y));
    const Ints middle = to_ints(lands ? own_y : none) * from.target_width + to_ints(lands ? own_x : none);
    int tiles = 0; /* to each side */
    while (ANY(lands & (most > (float)(3 * tiles + 1)))) ++tiles;
    /* All that is covered lies in the boxes, unless these are cut off. */
    const bool all_within = crack_closing && tiles == 0
                            && ALL(!lands | ((x >= 1.0f) & (y >= 1.0f) & (x < width - 1.0f) & (y < height - 1.0f)));
    for (int down = -3 * tiles; down <= 3 * tiles; down += 3)
        for (int across = -3 * tiles; across <= 3 * tiles; across += 3) {
            const Floats tile_x = own_x + (float)across, tile_y = own_y + (float)down;
            Ints covers = covered_tile(tile_x, tile_y, at, f);
            if (!all_within) covers &= tile_within(tile_x, tile_y, box);
            if (across == 0 && down == 0) covers |= own ? (Ints)(16) : (Ints)(0);
            offer_tile(lands ? covers : (Ints)(0), middle + (down * from.target_width + across), z, src,
                       from.target_width, to, pass);
        }
}

/* Whether any of the target blocks that a source block reaches is splatted. */
INLINE bool any_splatted(const int block, const int target_width, __global const short4 *reach,
                         __global const uchar *block_class) {
    const int4 reached = convert_int4(reach[block]);
    for (int y = reached.y; y <= reached.w; ++y)
        for (int x = reached.x; x <= reached.z; ++x)
            if (block_class[y * block_columns(target_width) + x] == SPLATTED) return true;
    return false;
}

/* LANES fragments per work-item; those that reach only blocks that are warped backward are left out. Finds layers for
   silhouettes, too, which need the same positions. Empties the lists of open and of soft pixels. */
LISTS __kernel void splat(__constant Frame *restrict frame, const int pass, __global const float *depth,
                          __global const uchar *links, __global const float *target_position,
                          __global const short4 *reach, __global const uchar *block_class, __global const uchar *smooth,
                          __global const half *codes, __global const uchar *level_state,
                          __global const float *level_depth, __global const uint *level_color, __global Key *keys,
                          __global uint *winners, __global uchar *layer, __global uint *behind, __global uchar *share,
                          __global uchar *marked, __global uint *open, __global uint *soft) {
    const int width = frame->source_width, height = frame->source_height;
    const int src_x = get_global_id(0) * LANES, src_y = get_global_id(1), src = src_y * width + src_x;
    if (src_x == 0 && src_y == 0) open[0] = soft[0] = 0;

    /* GPUs ask once for all pixels of a block whether it is splatted. */
    const bool of_blocks = frame->blocks && frame->crack_closing, is_pixel = src_x < width && src_y < height;
    const int block = block_of(src_x, src_y, width);
    const int of_group = get_local_id(1) / BLOCK_HEIGHT * BLOCK_HEIGHT + get_local_id(0) / BLOCK_WIDTH;
    __local uchar splatted[2 * BLOCK_HEIGHT];
    if (LANES == 1) {
        if (of_blocks && is_pixel && src_x % BLOCK_WIDTH == 0 && src_y % BLOCK_HEIGHT == 0)
            splatted[of_group] = any_splatted(block, frame->target_width, reach, block_class);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (!is_pixel) return;
    const Fragments from = fragments_of(frame, depth, target_position, links);
    const Winners to = {keys, winners};
    const Memory memory = {frame->levels > 0, frame->code_offset, level_state, level_depth, level_color};
    const FoundLayers layers = {.layer = layer, .behind = behind, .share = share, .marked = marked};
    if (frame->softens && pass == 0)
        find_layers(src_x, src_y, frame, depth, links, smooth, target_position, codes, memory, layers);
    if (of_blocks && !(LANES == 1 ? splatted[of_group] : any_splatted(block, frame->target_width, reach, block_class)))
        return;
    splat_fragments(from, to, src, width - src_x, frame->crack_closing, pass);
}

/* ---- resample ------------------------------------------------------------------------------------------------ */

/* The fragments that won LANES pixels. */
typedef struct {
    Ints x, y; /* in the rendered frame; of lanes that none won, anywhere in it */
    Ints exist; /* lanes that one won */
    Ints smooth; /* those in a block where nothing moves apart, and all taps around are in the image */
} Found;

/* px by which fragments at (dx, dy) from the winners deviate from the motion of the winners' surroundings. */
INLINE Floats deviation(const Floats there_x, const Floats there_y, const Floats dx, const Floats dy,
                        const Positions at, const WideFlow f) {
    const Floats ex = fabs(there_x - at.x.here - f.xx * dx - f.yx * dy),
                 ey = fabs(there_y - at.y.here - f.xy * dx - f.yy * dy);
    return ex > ey ? ex : ey;
}

/* Motion below STILL is rounding, and counts as none. */
INLINE Floats without_rounding(const Floats d) { return fabs(d) < STILL ? (Floats)(0.0f) : d; }

/* By how much the nearest so far of the surfaces beside deviates from the winners' motion. */
INLINE void carry(const Ints beside, const Floats depth, const Floats x, const Floats y, Floats *nearest, Floats *off_x,
                  Floats *off_y) {
    const Ints nearer = beside & (depth < *nearest);
    *nearest = nearer ? depth : *nearest;
    *off_x = nearer ? x : *off_x;
    *off_y = nearer ? y : *off_y;
}

/* A pixel beside a nearer surface has a mixture of both colors. Gives the step, in source pixels, to where its color
   is: from a surface that moves away to the neighbor without it, if that one moves along; beside one that hardly does,
   to where the mixture is if it goes along with the nearer surface. 0 for the others. */
INLINE void step_off_silhouettes(const Fragments from, const Found won, const Places places, const Positions at,
                                 const WideFlow f, Floats *step_x, Floats *step_y) {
    const Floats one = (Floats)(1.0f), none = (Floats)(0.0f);
    const Ints some = won.exist & !won.smooth, forth = (Ints)(1), back = (Ints)(-1), stay = (Ints)(0);
    *step_x = *step_y = none;
    if (!ANY(some)) return;
    Cross depth;
    load_cross(from.depth, from.width, places, &depth);
    const Floats near = depth.here * NEARER;
    const Ints left = some & (won.x > 0) & (depth.left < near),
               right = some & (won.x < from.width - 1) & (depth.right < near);
    const Ints up = some & (won.y > 0) & (depth.up < near),
               down = some & (won.y < from.height - 1) & (depth.down < near);
    if (!ANY(left | right | up | down)) return;

    /* Back by what the nearest surface moves farther. */
    Floats nearest = near, off_x = none, off_y = none;
    carry(left, depth.left, at.x.left - at.x.here + f.xx, at.y.left - at.y.here + f.xy, &nearest, &off_x, &off_y);
    carry(right, depth.right, at.x.right - at.x.here - f.xx, at.y.right - at.y.here - f.xy, &nearest, &off_x, &off_y);
    carry(up, depth.up, at.x.up - at.x.here + f.yx, at.y.up - at.y.here + f.yy, &nearest, &off_x, &off_y);
    carry(down, depth.down, at.x.down - at.x.here - f.yx, at.y.down - at.y.here - f.yy, &nearest, &off_x, &off_y);
    const Ints together = (fabs(off_x) <= SAME_MOTION) & (fabs(off_y) <= SAME_MOTION);
    *step_x = together ? without_rounding(wide_divide(f.yx * off_y - f.yy * off_x, f.det)) : none;
    *step_y = together ? without_rounding(wide_divide(f.xy * off_x - f.xx * off_y, f.det)) : none;

    /* Away from the nearer surfaces that move away. */
    const Ints from_left = left & (deviation(at.x.left, at.y.left, -one, none, at, f) > MOVES_AWAY),
               from_right = right & (deviation(at.x.right, at.y.right, one, none, at, f) > MOVES_AWAY);
    const Ints from_up = up & (deviation(at.x.up, at.y.up, none, -one, at, f) > MOVES_AWAY),
               from_down = down & (deviation(at.x.down, at.y.down, none, one, at, f) > MOVES_AWAY);
    const Ints x = (from_left ? forth : stay) + (from_right ? back : stay),
               y = (from_up ? forth : stay) + (from_down ? back : stay);
    if (!ANY((x != 0) | (y != 0))) return;

    /* If the neighbor there moves along. */
    Places there;
    find_places(places.at + y * from.width + x, 0, from.plane, &there);
    const Ints within = (won.x + x >= 0) & (won.x + x < from.width) & (won.y + y >= 0) & (won.y + y < from.height);
    const Ints along =
        within
        & (deviation(floats_beside(from.target_position, there, 0),
                     floats_beside(from.target_position + from.plane, there, 0), to_floats(x), to_floats(y), at, f)
           <= SAME_MOTION);
    *step_x += along ? to_floats(x) : none;
    *step_y += along ? to_floats(y) : none;
}

/* Which taps around (ox, oy) from the winners move alike: bits 0 to 3 the inner ones, 4 to 7 the corners. */
INLINE Ints taps_alike(const Fragments from, const Found won, const Floats ox, const Floats oy, const Positions at,
                       const WideFlow f) {
    const int width = from.width, height = from.height;
    const Ints x = won.x + to_ints(ox), y = won.y + to_ints(oy);
    const bool within = ALL((x >= 1) & (y >= 1) & (x < width - 2) & (y < height - 2));
    Places base;
    find_places(y * width + x, 2 * width + 2, from.plane, &base);
    Ints alike = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 8; ++k) {
        if (k == 4 && !ANY(alike == 0xF)) break; /* corners only count where all others are alike */
        const int dx = k < 4 ? (k & 1) : 3 * (k & 1) - 1, dy = k < 4 ? (k >> 1) : 3 * ((k >> 1) & 1) - 1;
        const Floats there_x = floats_beside(from.target_position, base, dy * width + dx),
                     there_y = floats_beside(from.target_position + from.plane, base, dy * width + dx);
        Ints tap_alike = deviation(there_x, there_y, ox + (float)dx, oy + (float)dy, at, f) <= SAME_MOTION;
        if (!within) tap_alike &= (x + dx >= 0) & (x + dx < width) & (y + dy >= 0) & (y + dy < height);
        alike |= tap_alike ? (Ints)(1 << k) : (Ints)(0);
    }
    return alike;
}

/* The first `count` of LANES pixels that are no holes. `own`: lanes whose fragment lands on them. */
INLINE void store_labels(const NewFrame to, const int dst, const int count, const Bytes dynamic_mask, const Ints own) {
    store_some_bytes(min(dynamic_mask, (Bytes)(DYNAMIC)), count, to.dynamic_mask + dst);
    store_some_bytes((Bytes)(0), count, to.disoccluded + dst);
    store_some_bytes(to_bytes(own ? (Ints)(BY_WARP) : (Ints)(BY_CRACK_CLOSING)), count, to.filled_by + dst);
}

/* `count` pixels, but for their color, from the fragments that won them. */
INLINE void resolve_found(const Fragments from, const Rendered shown, const Found won, const NewFrame to,
                          const int dst_x, const int dst_y, const int count, Samples *samples) {
    /* Where the fragments go, and their flow. */
    const int dst = dst_y * from.target_width + dst_x;
    const Floats center_x = row_centers(dst_x);
    const float center_y = (float)dst_y + 0.5f;
    const Ints src = won.y * from.width + won.x;
    Places places;
    find_places(src, from.width + 1, from.plane, &places);
    Positions at;
    load_positions(from, places, &at);
    WideFlow f;
    wide_flow(at, to_ints(bytes_at(from.links, places)), floats_at(from.depth, places), from.zoom, &f);
    Floats step_x, step_y;
    step_off_silhouettes(from, won, places, at, f, &step_x, &step_y);

    /* The place within each fragment that lands on the pixel's center. */
    const Floats ex = center_x - at.x.here, ey = center_y - at.y.here, z = at.z.here;
    const Floats dx = without_rounding(clamp(wide_divide(f.yy * ex - f.yx * ey, f.det), -1.0f, 1.0f));
    const Floats dy = without_rounding(clamp(wide_divide(f.xx * ey - f.xy * ex, f.det), -1.0f, 1.0f));

    /* The taps around that place, or around the one beside to which it steps. */
    /* Lanes without a fragment look at pixel 0, which may have no depth, and so no place. */
    const Floats from_x = won.exist ? dx + step_x : (Floats)(0.0f), from_y = won.exist ? dy + step_y : (Floats)(0.0f);
    samples_at(src, from_x, from_y, from.width, samples);
    const Ints alike = won.smooth | ((from_x == 0.0f) & (from_y == 0.0f));
    if (!ALL(alike | !won.exist))
        samples->alike = alike ? samples->alike : taps_alike(from, won, floor(from_x), floor(from_y), at, f);

    /* The pixel: depth, motion, labels. */
    const Floats out_z = z + f.xz * dx + f.yz * dy;
    store_some_floats(out_z > 0.0f ? out_z : z, count, to.depth + dst);
    store_some_xy((to_floats(won.x) + 0.5f) + dx - center_x, (to_floats(won.y) + 0.5f) + dy - center_y, count,
                  to.motion + dst);
    store_labels(to, dst, count, bytes_at(shown.dynamic_mask, places),
                 (floor(at.x.here) == center_x - 0.5f) & (floor(at.y.here) == center_y - 0.5f));
}

/* The fragments that were splatted nearest. A block at the image's border may only be smooth if it is RESTING. A place
   a whole pixel to the right or down of a fragment has taps three pixels from it. */
INLINE void found_by_splatting(const Fragments from, __global const Key *keys, __global const uint *winners,
                               __global const uchar *source_smooth, const int dst, const int count, Found *won) {
    const Uints src = load_some_winners(count, keys, winners, dst);
    const Ints exist = (src != NOBODY) & (LANE_NUMBERS < count);
    Ints x, y;
    wide_column_and_row(exist ? to_ints(src) : (Ints)(0), from.width, &x, &y);
    const Ints blocks = y / BLOCK_HEIGHT * block_columns(from.width) + x / BLOCK_WIDTH;
    const Ints smooth = to_ints(gather_bytes(source_smooth, blocks));
    const Ints inner = (x >= 2) & (y >= 2) & (x < from.width - 2) & (y < from.height - 2);
    won->x = x;
    won->y = y;
    won->exist = exist;
    const Ints has_taps = (x < from.width - 3) & (y < from.height - 3);
    won->smooth = exist & (smooth != 0) & ((smooth != RESTING) | inner) & has_taps;
}

/* LANES pixels of a block, but for their color, from the places where they come from by the inverse of its flow:
   `source` is find_source's of backward_blocks.cl. */
INLINE void resolve_block(const Fragments from, const Rendered shown, const NewFrame to, const float8 source,
                          const int dst_x, const int dst_y, Samples *samples) {
    const int dst = dst_y * from.target_width + dst_x;
    const Floats from_x = row_centers(dst_x % BLOCK_WIDTH) - 0.5f * (float)BLOCK_WIDTH;
    const float from_y = (float)(dst_y % BLOCK_HEIGHT) + 0.5f - 0.5f * (float)BLOCK_HEIGHT;
    const Floats px_x = source.s0 + source.s2 * from_x + source.s3 * from_y;
    const Floats px_y = source.s1 + source.s4 * from_x + source.s5 * from_y;
    const Ints src_x = clamp(to_ints(px_x), (Ints)(2), (Ints)(from.width - 3));
    const Ints src_y = clamp(to_ints(px_y), (Ints)(2), (Ints)(from.height - 3));
    const Floats src_center_x = to_floats(src_x) + 0.5f, src_center_y = to_floats(src_y) + 0.5f;
    const Floats dx = without_rounding(px_x - src_center_x), dy = without_rounding(px_y - src_center_y);
    const Ints src = src_y * from.width + src_x;
    Places places;
    find_places(src, from.width + 1, from.plane, &places);
    if (LANES == 1) places.one = true; /* its neighbors are in the image */

    Cross z;
    load_cross(from.target_position + 2 * from.plane, from.width, places, &z);
    const Ints bits = to_ints(bytes_at(from.links, places));
    const Ints level_x = isinf(z.here) | ((bits & (LINK_LEFT | LINK_RIGHT)) != (LINK_LEFT | LINK_RIGHT));
    const Ints level_y = isinf(z.here) | ((bits & (LINK_UP | LINK_DOWN)) != (LINK_UP | LINK_DOWN));
    const Floats across = level_x ? (Floats)(0.0f) : (z.right - z.left) * 0.5f,
                 down = level_y ? (Floats)(0.0f) : (z.down - z.up) * 0.5f;
    const Floats out_z = z.here + across * dx + down * dy;
    store_floats(out_z > 0.0f ? out_z : z.here, 0, to.depth + dst);
    store_xy(src_center_x + dx - row_centers(dst_x), src_center_y + dy - ((float)dst_y + 0.5f), to.motion + dst);
    store_labels(to, dst, LANES, bytes_at(shown.dynamic_mask, places),
                 (fabs(source.s5 * dx - source.s3 * dy) * source.s6 <= 0.5f)
                     & (fabs(source.s2 * dy - source.s4 * dx) * source.s6 <= 0.5f));
    samples_at(src, dx, dy, from.width, samples);
}

/* A pixel that is left to later stages. */
INLINE void leave_open(const int dst, const NewFrame to, const int unfilled_label) {
    store_color((float3)(0.0f), to.color, dst);
    to.depth[dst] = INFINITY;
    to.motion[dst] = (float2)(0.0f);
    to.dynamic_mask[dst] = STATIC;
    to.disoccluded[dst] = 1;
    to.filled_by[dst] = unfilled_label;
}

/* LANES pixels of a COPIED block, as they are in the rendered frame. */
INLINE void copy_pixels(const Fragments from, const Rendered shown, const NewFrame to, const int pixel) {
#pragma unroll
    for (int part = 0; part < PARTS; ++part) {
        Texels c = load_texels(part, shown.color + 4 * pixel);
        VALID(c) = (float)0;
        store_texels(c, part, to.color + 4 * pixel);
    }
    store_floats(load_floats(0, from.depth + pixel), 0, to.depth + pixel);
    store_xy((Floats)(0.0f), (Floats)(0.0f), to.motion + pixel);
    store_labels(to, pixel, LANES, (Bytes)(STATIC), ALL_LANES);
}

/* LANES pixels per work-item. Lists those that are open. */
LISTS __kernel void resolve(__constant Frame *restrict frame, const int unfilled_label,
                            __global const uchar *block_class, __global const float8 *block_source,
                            __global const uchar *source_smooth, __global const Key *keys, __global const uint *winners,
                            __global const half *color, __global const half *codes, __global const float *depth,
                            __global const uchar *dynamic_mask, __global const uchar *links,
                            __global const float *target_position, __global const float *sharpness,
                            __global half *out_color, __global float *out_depth, __global float2 *out_motion,
                            __global uchar *out_dynamic, __global uchar *disoccluded, __global uchar *filled_by,
                            __global uint *open) {
    const int width = frame->source_width, target_width = frame->target_width, target_height = frame->target_height;
    const Fragments from = fragments_of(frame, depth, target_position, links);
    const Rendered shown = rendered_of(frame, color, codes, dynamic_mask, sharpness);
    const NewFrame to = {.color = out_color,
                         .depth = out_depth,
                         .motion = out_motion,
                         .dynamic_mask = out_dynamic,
                         .disoccluded = disoccluded,
                         .filled_by = filled_by};
    const int dst_x = get_global_id(0) * LANES, dst_y = get_global_id(1), dst = dst_y * target_width + dst_x;
    const bool is_pixel = dst_x < target_width && dst_y < target_height;
    const int block = is_pixel ? block_of(dst_x, dst_y, target_width) : 0;
    const uchar class = block_class[block];
    Ints left = (Ints)(0); /* lanes that are left open */
    if (is_pixel && class == COPIED) {
        copy_pixels(from, shown, to, dst);
    } else if (is_pixel) {
        const int count = target_width - dst_x;
        Found won = {.exist = ALL_LANES};
        Samples samples = {0};
        if (class == BACKWARD) {
            resolve_block(from, shown, to, block_source[block], dst_x, dst_y, &samples);
        } else {
            found_by_splatting(from, keys, winners, source_smooth, dst, count, &won);
            if (ANY(won.exist)) resolve_found(from, shown, won, to, dst_x, dst_y, count, &samples);
            left = !won.exist & (LANE_NUMBERS < count);
        }
        resample_lanes(samples, won.exist, width, shown, dst, out_color);
    }
    for (int k = 0; ANY(left) && k < LANES; ++k)
        if (int_of(&left, k)) leave_open(dst + k, to, unfilled_label);
    __local uint shared[2];
    append_lanes(left, to_uints(dst + LANE_NUMBERS), open, shared);
}
