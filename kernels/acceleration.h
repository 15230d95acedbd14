/* Acceleration of movers (beyond the paper: 'Position estimation' with a second-order term where it can be trusted).
   The nearest mover of each cell has a mean velocity; its change since the frame before, met where the mover's
   motion points to, is its acceleration. Noise and bad vectors do not last, and neither does a bounce or a stop:
   only as far as the interval before confirms it does it count, and a share where that is not known. On arcs
   acceleration turns: it turns on by the angle by which it turned. What turns by more than a quarter in an
   interval, as wheels do, moves on as its center does. Cells without a mover are skipped. Some movers are carried by
   the camera, as wipers and hands are: where velocity in view space has changed less since the frame before than that
   in the world, here and around, velocity and acceleration go on in view space, until it moves less in the world. */

#include "frame.h"
#include "mover_grid.h"

/* What set the thresholds: docs/deviations.md, "Movers' acceleration goes on", "Objects that the camera carries move
   on in view space", "What spins moves on as its center does". */
#define BEND_MOST 0.5f /* share of the velocity: the more an acceleration in doubt exceeds it, the less it counts */
#define FIRST 0.5f /* share of an acceleration that counts where that of the interval before is not known */
#define LASTS 1.5f /* times the share of it that there was before: what counts, at most all of it */
/* IN_VIEW: the camera carries a mover whose squared change of velocity in view space is below this share of that in the
   world */
#define IN_VIEW 0.5f
#define KEEPS_UP 0.0625f /* share of the squared velocity: what is slower in view space keeps up with the camera */
#define NEXT_CELLS 3 /* cells to those around: of a 3x3 */
/* SHAKEN: a mover begins to be carried only where its velocity in the world has changed by more than this share of
   its distance: without a shake both spaces fit */
#define SHAKEN 0.004f
/* SPIN_SIZES: what spins has squared accelerations that differ by at most this factor from one interval to the next ...
 */
#define SPIN_SIZES 1.25f
#define STILL_SPINS 2.0f /* ... or by this one where it did before ... */
#define SPIN_LEAST 2.0f /* px: ... and are at least so long: smaller ones may be errors */

/* Mean values of a cell's fragments of one mover. */
typedef struct {
    float3 velocity; /* in the world, along the axes of view space; world units per interval */
    float3 view_velocity; /* in view space */
    float2 px_prev; /* where they were */
    float depth, depth_prev;
} Mover;

/* The rendered frame, and the results of history tracking for its fragments. */
typedef struct {
    __global const float *depth;
    __global const float2 *motion;
    __global const uchar *dynamic_mask;
    __global const float *met_depth;
} Tracked;

INLINE bool is_known(const Tracked f, const int src) {
    return f.dynamic_mask[src] == DYNAMIC && f.met_depth[src] > 0.0f;
}

/* The nearest mover of a cell; depth 0 without one. */
INLINE Mover mover_of_cell(const int cell_x, const int cell_y, __constant Frame *frame, const Tracked f) {
    const int source_width = frame->source_width, source_height = frame->source_height;
    const int end_x = min((cell_x + 1) * MOVER_CELL, source_width),
              end_y = min((cell_y + 1) * MOVER_CELL, source_height);
    Mover mover = {(float3)(0.0f), (float3)(0.0f), (float2)(0.0f), 0.0f, 0.0f};
    if (end_x - cell_x * MOVER_CELL == MOVER_CELL && end_y - cell_y * MOVER_CELL == MOVER_CELL) {
        __global const uchar *row = f.dynamic_mask + cell_y * MOVER_CELL * source_width + cell_x * MOVER_CELL;
        const uchar4 any = vload4(0, row) | vload4(0, row + source_width) | vload4(0, row + 2 * source_width)
                           | vload4(0, row + 3 * source_width);
        if (as_uint(any) == 0) return mover;
    }
    float nearest = INFINITY;
    for (int src_y = cell_y * MOVER_CELL; src_y < end_y; ++src_y)
        for (int src_x = cell_x * MOVER_CELL; src_x < end_x; ++src_x) {
            const int src = src_y * source_width + src_x;
            if (is_known(f, src)) nearest = fmin(nearest, f.depth[src]);
        }
    if (isinf(nearest)) return mover;

    float count = 0.0f;
    for (int src_y = cell_y * MOVER_CELL; src_y < end_y; ++src_y)
        for (int src_x = cell_x * MOVER_CELL; src_x < end_x; ++src_x) {
            const int src = src_y * source_width + src_x;
            if (!is_known(f, src) || !is_of_cell(f.depth[src], nearest)) continue;
            const float2 px = pixel_center(src_x, src_y), px_prev = px + f.motion[src];
            const float3 p1_prev = unproject(px_prev, f.met_depth[src], frame->from_previous.source_inverse);
            const float3 p0 = unproject(px, f.depth[src], frame->to_previous.source_inverse);
            mover.velocity += p0 - move_to_target(p1_prev, frame->from_previous);
            mover.view_velocity += p0 - p1_prev;
            mover.px_prev += px_prev;
            mover.depth += f.depth[src];
            mover.depth_prev += f.met_depth[src];
            count += 1.0f;
        }
    mover.velocity = mean_of(mover.velocity, count);
    mover.view_velocity = mean_of(mover.view_velocity, count);
    mover.px_prev = (float2)(divide(mover.px_prev.x, count), divide(mover.px_prev.y, count));
    mover.depth = divide(mover.depth, count);
    mover.depth_prev = divide(mover.depth_prev, count);
    return mover;
}

/* The share of an acceleration that goes on, 0 to 1, by what there was of it an interval before. */
INLINE float lasted(const float3 acceleration, const float3 before) {
    const float size = squared_length(acceleration);
    return size > 0.0f ? clamp(LASTS * divide(product_of(acceleration, before), size), 0.0f, 1.0f) : 0.0f;
}

/* Weight of an acceleration, 0 to 1: `share` of it, and less where it is in doubt and bends the path sharply. */
INLINE float trust(const float3 velocity, const float3 acceleration, const float share) {
    const float size = squared_length(acceleration), speed = BEND_MOST * BEND_MOST * squared_length(velocity);
    return share < 1.0f && size > speed ? share * divide(speed, size) : share;
}

/* The change of an acceleration in the next interval, if it turns by the angle by which it has turned since `before`:
   on circles a(t + 1) = 2 cos a(t) - a(t - 1). The more that exceeds the acceleration, the less it counts. */
INLINE float3 change_of(const float3 acceleration, const float3 before) {
    const float most = squared_length(acceleration), both = most + squared_length(before);
    const float cosine = both > 0.0f ? divide(2.0f * product_of(acceleration, before), both) : 0.0f;
    const float3 change = (2.0f * cosine - 1.0f) * acceleration - before;
    const float size = squared_length(change);
    return size > most ? divide(most, size) * change : change;
}

/* How a mover moved in the frame before, met where its motion points to: means over its cells there. */
typedef struct {
    float3 velocity, view_velocity;
    float3 acceleration; /* where it is known */
    float weight, weight_known, weight_spun; /* of cells of the mover, of those with an acceleration, that spun */
    bool was_carried;
} Past;

/* The movers' grid of the frame before. */
typedef struct {
    __global const float4 *velocity;
    __global const uint2 *acceleration, *bend, *view_velocity;
} Grid;

INLINE Past past_of(const Mover mover, const int level_width, const int level_height, const Grid grid) {
    Past past = {(float3)(0.0f), (float3)(0.0f), (float3)(0.0f), 0.0f, 0.0f, 0.0f, false};
    const float per_px = 1.0f / (float)MOVER_CELL;
    const float fx = mover.px_prev.x * per_px - 0.5f, fy = mover.px_prev.y * per_px - 0.5f;
    const int x0 = (int)floor(fx), y0 = (int)floor(fy);
#pragma unroll 1
    for (int tap = 0; tap < 4; ++tap) {
        const int x = x0 + (tap & 1), y = y0 + (tap >> 1), i = y * level_width + x;
        if (!inside(x, y, level_width, level_height)) continue;
        const float4 v = grid.velocity[i];
        if (!(v.w > 0.0f) || !is_of_cell(v.w, mover.depth_prev)) continue;
        const float weight = bilinear_weight(tap, fx - (float)x0, fy - (float)y0);
        past.velocity += weight * v.xyz;
        past.view_velocity += weight * unpacked(grid.view_velocity[i]);
        past.was_carried |= is_trusted(grid.view_velocity[i]);
        past.weight += weight;
        const uint2 a = grid.acceleration[i];
        if (!is_trust_known(a)) continue;
        past.acceleration += weight * unpacked(a);
        past.weight_known += weight;
        if (!is_trust_known(grid.bend[i])) past.weight_spun += weight;
    }
    if (!(past.weight > 0.0f)) return past;
    past.velocity = mean_of(past.velocity, past.weight);
    past.view_velocity = mean_of(past.view_velocity, past.weight);
    if (past.weight_known > 0.0f) past.acceleration = mean_of(past.acceleration, past.weight_known);
    return past;
}

/* A mover's squared change of velocity since the frame before: in view space, in the world. */
INLINE float2 changes(const Mover mover, const Past past, __constant Frame *frame) {
    const float ratio = frame->interval_ratio;
    const float3 was = ratio * rotate_to_target(past.velocity, frame->from_previous);
    return (float2)(squared_length(mover.view_velocity - ratio * past.view_velocity),
                    squared_length(mover.velocity - was));
}

/* Whether a mover's squared velocity in view space is below a share of that in the world. */
INLINE bool is_slower_in_view(const Mover mover, const float share) {
    return squared_length(mover.view_velocity) < share * squared_length(mover.velocity);
}

/* Whether the cells around must be asked if the camera carries a mover, by its own `changes`. */
INLINE bool leans(const Mover mover, const Past past, const float2 own, __constant Frame *frame) {
    const float shaken = SHAKEN * mover.depth;
    return frame->camera_fixed && !past.was_carried && is_slower_in_view(mover, 1.0f) && own.x < own.y
           && own.y > shaken * shaken;
}

/* Whether a mover spins: accelerations of the last two intervals, alike but for their direction, are more than a
   quarter of a turn apart. With radius vectors q0, q1, q2 of the last three places, which turn by the same angle, the
   accelerations are -(1 - cos) q1 and -(1 - cos) q2, and q0 = 2 cos q1 - q2; *center is its center's velocity. */
INLINE bool spins(const float3 velocity, const float3 found, const float3 before, const float sizes, const float px,
                  float3 *center) {
    const float size = squared_length(found), size_before = squared_length(before), both = product_of(found, before);
    if (!(both < 0.0f && size > SPIN_LEAST * SPIN_LEAST * px * px && size < sizes * size_before
          && size_before < sizes * size))
        return false;
    const float cosine = divide(2.0f * both, size + size_before);
    *center = velocity - divide(1.0f, 1.0f - cosine) * ((1.0f - 2.0f * cosine) * found + before);
    return true;
}

/* Results of cells. velocity: (xyz, view depth of the mover, 0: none). acceleration: per interval squared, as found,
   and its trust, -1 where it is not known. bend: its change in the next interval, as far as it counts, and the same
   trust: after alpha intervals alpha (alpha + 1) (trust acceleration + (alpha + 2) / 3 bend) was added to positions;
   its trust is -1 where the mover spins, and it is its center's velocity. view_velocity: in view space, and 1 where the
   camera carries the mover: acceleration and bend are of view space there. */
typedef struct {
    __global float4 *velocity;
    __global uint2 *acceleration, *bend, *view_velocity;
} Cells;

/* Tracks the mover of cell number `cell`, if there are so many. `before`: the cells of the frame before. */
INLINE void track_cell(const int cell, __constant Frame *frame, const Tracked fragments, const Grid before,
                       const Cells to) {
    const int level_width = (frame->source_width + MOVER_CELL - 1) / MOVER_CELL;
    const int level_height = (frame->source_height + MOVER_CELL - 1) / MOVER_CELL;
    const float ratio = frame->interval_ratio; /* of the last two intervals */
    const int cell_x = cell % level_width, cell_y = cell / level_width;
    if (cell_y >= level_height) return;
    to.velocity[cell] = (float4)(0.0f);
    to.acceleration[cell] = packed((float3)(0.0f), -1.0f);
    to.bend[cell] = to.view_velocity[cell] = packed((float3)(0.0f), 0.0f);
    Mover mover;
    Past past;
    float2 own = (float2)(0.0f), all = (float2)(0.0f); /* changes: of this cell, and with those around */
    float depth_here = 0.0f;
    int asked = 0;
    /* This cell; where it leans, the eight around, and it again: so few registers stay in use. */
    for (; asked < 10; ++asked) {
        const int place = (asked + 4) % 9;
        const int x = cell_x + (place % 3 - 1) * NEXT_CELLS, y = cell_y + (place / 3 - 1) * NEXT_CELLS;
        if (!inside(x, y, level_width, level_height)) continue;
        mover = mover_of_cell(x, y, frame, fragments);
        if (asked == 0) depth_here = mover.depth;
        if (!(depth_here > 0.0f)) return;
        if (!(mover.depth > 0.0f) || !is_of_cell(mover.depth, depth_here)) continue;
        past = past_of(mover, level_width, level_height, before);
        const float2 change = past.weight > 0.0f ? changes(mover, past, frame) : (float2)(0.0f);
        if (asked == 0) own = change;
        if (asked < 9) all += change;
        if (asked == 0 && !leans(mover, past, own, frame)) break;
    }
    to.velocity[cell] = (float4)(mover.velocity, mover.depth);
    to.view_velocity[cell] = packed(mover.view_velocity, 0.0f);
    if (!(past.weight > 0.0f)) return;
    float3 now = mover.velocity, was = ratio * rotate_to_target(past.velocity, frame->from_previous);
    const bool carried = asked > 0 ? all.x < (is_slower_in_view(mover, KEEPS_UP) ? 1.0f : IN_VIEW) * all.y
                                   : frame->camera_fixed && past.was_carried && is_slower_in_view(mover, 1.0f);
    if (carried) {
        now = mover.view_velocity;
        was = ratio * past.view_velocity;
        to.view_velocity[cell] = packed(now, 1.0f);
    }
    const float3 found = (now - was) * divide(ratio, 1.0f + ratio);
    float share = FIRST;
    float3 change = (float3)(0.0f);
    if (past.weight_known > 0.0f && carried == past.was_carried) {
        const float3 found_before = ratio * ratio * past.acceleration;
        const float3 was_found = carried ? found_before : rotate_to_target(found_before, frame->from_previous);
        share = lasted(found, was_found);
        change = change_of(found, was_found);
        float3 center;
        const float px = mover.depth * frame->to_previous.source_inverse.x;
        if (spins(now, found, was_found, past.weight_spun > 0.5f * past.weight ? STILL_SPINS : SPIN_SIZES, px,
                  &center)) {
            to.acceleration[cell] = packed(found, 0.0f);
            to.bend[cell] = packed(center, -1.0f);
            return;
        }
    }
    const float trusted = trust(now, found, share);
    to.acceleration[cell] = packed(found, trusted);
    to.bend[cell] = packed(trusted * change, trusted);
}
