/* Dilated warp, the cheap one: every pixel carries the motion of the nearest pixel of the 3x3 around it (dilation), so
   that antialiased edges move along with the nearer surface, in the manner of Mob-FGSR (Yang et al., SIGGRAPH 2024);
   here it is the predicted motion (prediction.cl), with a known camera.

   splat_dilated: each pixel carries where it comes from to where it goes. There the nearest surface wins (nearest.h).
   resample_dilated: each pixel of the new frame looks up the place that it was given. A pixel without one moves as the
   nearest surface beside, whose surroundings were seen there; far from any it moves as far surfaces do. */

#include "frame.h"
#include "resampling.h"
#include "nearest.h"
#include "flow.h"
#include "dilation.h"

/* What set the thresholds: docs/deviations.md, "The dilated warp". */
#define GONE 2.0f /* px: what is shown so far from a pixel is not shown there */
#define PARTS_BY 1.0f /* px: a pixel beside a mover that moves so much otherwise ... */
#define LEAST_MIXED 0.125f /* ... is carried along if it has such a share of the nearer surface's color */

/* How far LANES pixels, whose indices are `here`, lie from the pixels `nearest` among the 3x3 around them. */
INLINE Floats away_from(const Ints nearest, const Ints here, const int width, Floats *down) {
    const Ints step = here - nearest, rows = step > 1 ? (Ints)(1) : step < -1 ? (Ints)(-1) : (Ints)(0);
    *down = to_floats(rows);
    return to_floats(step - rows * width);
}

/* LANES pixels of the rendered frame per work-item. A word holds where the new frame's pixel at (x, y) comes from, less
   (x, y) / zoom. */
WIDE __kernel void splat_dilated(__constant Frame *restrict frame, const int pass, __global const float *depth,
                                 __global const float *target_position, __global Key *keys, __global uint *winners) {
    const int width = frame->source_width, height = frame->source_height, plane = width * height;
    const float2 zoom = frame->zoom;
    const int x = get_global_id(0) * LANES, y = get_global_id(1);
    if (x >= width || y >= height) return;
    Ints nearest;
    find_nearest(depth, x, y, width, height, &nearest);
    const Ints here = min((Ints)(y * width + x + LANE_NUMBERS), (Ints)(y * width + width - 1));
    Places places;
    find_places(nearest, 0, plane, &places);
    Floats down;
    const Floats across = away_from(nearest, here, width, &down);
    const Floats z = floats_at(target_position + 2 * plane, places);
    const Floats px_x = floats_at(target_position, places) + zoom.x * across,
                 px_y = floats_at(target_position + plane, places) + zoom.y * down;
    const Floats from_x = row_centers(x) - px_x * divide(1.0f, zoom.x),
                 from_y = (float)y + 0.5f - px_y * divide(1.0f, zoom.y);
    const Ints lands = (z > 0.0f) & (px_x >= 0.0f) & (px_x < (float)frame->target_width) & (px_y >= 0.0f)
                       & (px_y < (float)frame->target_height) & (fabs(from_x) <= LONGEST) & (fabs(from_y) <= LONGEST);
    if (!ANY(lands)) return;
    offer_vectors(pass, keys, winners, width - x, frame->target_width, lands, px_x, px_y, from_x, from_y, z);
}

/* Whether a surface shown at `there` has gone from the pixel at px. */
INLINE bool has_gone(const float2 there, const float2 px) {
    return fabs(there.x - px.x) > GONE || fabs(there.y - px.y) > GONE;
}

/* `place`, or a pixel aside where that is beside a nearer static surface which has gone from px: antialiased colors
   there hold some of it, and would repeat its outline. */
INLINE float2 off_outline(const Origin from, __global const float *target_position, __global const uchar *is_dynamic,
                          const float2 zoom, const float2 px, const float2 place) {
    const int x = (int)place.x, y = (int)place.y, src = y * from.width + x;
    if (!(place.x >= 1.0f && place.y >= 1.0f && x < from.width - 1 && y < from.height - 1)) return place;
    const float z = from.z[src];
    int2 away = (int2)(0), tap = (int2)(0);
    for (int k = 1; k < 9; ++k) {
        const float beside = from.z[src + TAP_Y(k) * from.width + TAP_X(k)];
        if (!(beside > 0.0f && beside < NEARER * z)) continue;
        tap = (int2)(TAP_X(k), TAP_Y(k));
        away -= tap;
    }
    const int nearer = src + tap.y * from.width + tap.x;
    if (nearer == src || is_dynamic[nearer]) return place;
    const float3 there = position_of(target_position, nearer, from.width * from.height);
    if (!has_gone(there.xy - zoom * (float2)((float)tap.x, (float)tap.y), px)) return place;
    away = clamp(away, -1, 1);
    const float z_aside = from.z[src + away.y * from.width + away.x];
    const bool alike = !(z_aside < NEARER * z) && !(z < NEARER * z_aside);
    return alike ? place + (float2)((float)away.x, (float)away.y) : place;
}

/* Where the pixel (x, y), which none reached, comes from, less (x, y) / zoom: with the nearest surface within
   FILL_REACH px, of those that show nothing nearer than themselves there, as what uncovers the pixel would be. Without
   any it moves as far surfaces do. But where that shows a mover which has gone elsewhere, or at the image's border one
   that enters, it moves as that mover; so it does with a static surface where it moves as far ones. */
INLINE float2 place_beside(__constant Frame *frame, __global const Key *keys, __global const uint *winners,
                           __global const float *target_position, __global const uchar *is_dynamic, const int x,
                           const int y) {
    const int width = frame->source_width, height = frame->source_height, plane = width * height;
    const float2 px = pixel_center(x, y), per_px = (float2)(divide(1.0f, frame->zoom.x), divide(1.0f, frame->zoom.y)),
                 own = (float2)(px.x * per_px.x, px.y * per_px.y);
    const Origin from = {target_position + 2 * plane, width, height, own};
    const uint word = nearest_beside(keys, winners, x, y, frame->target_width, frame->target_height, from);
    float2 place = own;
    if (word != NOBODY) {
        place += components(word);
    } else {
        const float3 far = reproject(px, INFINITY, frame->to_source);
        if (far.z > 0.0f) place = far.xy;
    }
    const int src_x = clamp((int)place.x, 0, width - 1), src_y = clamp((int)place.y, 0, height - 1);
    const int src = src_y * width + src_x;
    const bool within = holds(width, height, place), moves = is_dynamic[src];
    if (moves || (within && word == NOBODY)) {
        const float3 there = position_of(target_position, src, plane);
        const float2 off = there.xy - px;
        const float2 moved = pixel_center(src_x, src_y) - (float2)(off.x * per_px.x, off.y * per_px.y);
        const int moved_x = clamp((int)moved.x, 0, width - 1), moved_y = clamp((int)moved.y, 0, height - 1);
        const int at = moved_y * width + moved_x;
        const bool is_free =
            !(from.z[at] < NEARER * there.z) && (moves || (holds(width, height, moved) && !is_dynamic[at]));
        if (there.z > 0.0f && is_free && (!within || has_gone(there.xy, px))) place = moved;
    }
    return off_outline(from, target_position, is_dynamic, frame->zoom, px, place) - own;
}

/* `place`, which a nearer surface beside carries to px. If a mover is involved and nothing of the nearer color is mixed
   into the pixel, which lies with that on its other side: where the surface that px shows behind comes from, the
   pixel's own or the one that hides it there. */
INLINE float2 place_behind(const Origin from, __global const half *codes, __global const float *target_position,
                           __global const uchar *is_dynamic, const float2 per_px, const float2 px, const float2 place) {
    const int x = (int)place.x, y = (int)place.y, width = from.width, src = y * width + x;
    if (x < 1 || y < 1 || x >= width - 1 || y >= from.height - 1) return place;
    int near = src, far = src;
    float least = NEARER * from.z[src];
    for (int k = 1; k < 9; ++k) {
        const int step = TAP_Y(k) * width + TAP_X(k);
        const float beside = from.z[src + step];
        if (!(beside > 0.0f && beside < least)) continue;
        least = beside;
        near = src + step;
        far = src - step;
    }
    if (!(is_dynamic[near] || is_dynamic[src]) || from.z[far] < NEARER * from.z[src]) return place;
    const float3 behind = stored_code(codes, far), whole = stored_code(codes, near) - behind,
                 part = stored_code(codes, src) - behind;
    if (near == src || dot(part, whole) > LEAST_MIXED * dot(whole, whole)) return place;
    for (int at = src, k = 0; k < 2; ++k) {
        const float3 there = position_of(target_position, at, width * from.height);
        const float2 off = there.xy - px;
        const float2 moved = pixel_center(at % width, at / width) - (float2)(off.x * per_px.x, off.y * per_px.y);
        if (!holds(width, from.height, moved)) break;
        at = (int)moved.y * width + (int)moved.x;
        if (from.z[at] < NEARER * there.z) continue;
        return fmax(fabs(moved.x - place.x), fabs(moved.y - place.y)) > PARTS_BY ? moved : place;
    }
    return place;
}

/* LANES pixels of the new frame per work-item. */
WIDE __kernel void resample_dilated(__constant Frame *restrict frame, __global const Key *keys,
                                    __global const uint *winners, __global const half *color,
                                    __global const half *codes, __global const uchar *dynamic_mask,
                                    __global const float *target_position, __global const float *sharpness,
                                    __global half *out_color, __global float *out_depth, __global float2 *out_motion,
                                    __global uchar *out_dynamic, __global uchar *disoccluded,
                                    __global uchar *filled_by) {
    const int width = frame->source_width, height = frame->source_height, plane = width * height;
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), dst = y * target_width + x, count = target_width - x;
    if (x >= target_width || y >= target_height) return;
    const Rendered shown = rendered_of(frame, color, codes, dynamic_mask, sharpness);
    const Uints word = load_some_winners(count, keys, winners, dst);
    const Ints reached = word != NOBODY;
    Floats from_x = component(word & 0xFFFFu), from_y = component(word >> 16);
    if (!ALL(reached)) {
        for (int k = 0; k < min(LANES, count); ++k) {
            if (int_of(&reached, k)) continue;
            const float2 from = place_beside(frame, keys, winners, target_position, dynamic_mask, x + k, y);
            set_float(&from_x, k, from.x);
            set_float(&from_y, k, from.y);
        }
    }
    const Floats center_x = row_centers(x);
    const float center_y = (float)y + 0.5f;
    const float2 per_px = (float2)(divide(1.0f, frame->zoom.x), divide(1.0f, frame->zoom.y));
    Floats px_x = clamp(from_x + center_x * per_px.x, 0.5f, (float)width - 0.5f),
           px_y = clamp(from_y + center_y * per_px.y, 0.5f, (float)height - 0.5f);

    /* Depth, motion and labels are those of the pixel that holds the place. */
    Ints src = to_ints(px_y) * width + to_ints(px_x);
    Places places;
    find_places(src, 0, plane, &places);
    Floats z = floats_at(target_position + 2 * plane, places);

    /* Which something nearer may have carried there. */
    bool some_carried = false;
    for (int k = 0; k < min(LANES, count); ++k) {
        if (!int_of(&reached, k) || !(as_float(depth_bits_of(keys, dst + k)) < NEARER * float_of(&z, k))) continue;
        const Origin from = {target_position + 2 * plane, width, height, (float2)(0.0f)};
        const float2 place = place_behind(from, codes, target_position, dynamic_mask, per_px, pixel_center(x + k, y),
                                          (float2)(float_of(&px_x, k), float_of(&px_y, k)));
        set_float(&px_x, k, clamp(place.x, 0.5f, (float)width - 0.5f));
        set_float(&px_y, k, clamp(place.y, 0.5f, (float)height - 0.5f));
        some_carried = true;
    }
    if (some_carried) {
        src = to_ints(px_y) * width + to_ints(px_x);
        find_places(src, 0, plane, &places);
        z = floats_at(target_position + 2 * plane, places);
    }
    store_some_floats(z > 0.0f ? z : (Floats)(INFINITY), count, out_depth + dst);
    store_some_xy(px_x - center_x, px_y - center_y, count, out_motion + dst);
    store_some_bytes(min(bytes_at(dynamic_mask, places), (Bytes)(DYNAMIC)), count, out_dynamic + dst);
    store_some_bytes(to_bytes(reached ? (Ints)(0) : (Ints)(1)), count, disoccluded + dst);
    store_some_bytes(to_bytes(reached ? (Ints)(BY_WARP) : (Ints)(BY_HOLE_FILLING)), count, filled_by + dst);

    /* Color: cubic, at the image's border bilinear. */
    const Floats left = floor(px_x - 0.5f), top = floor(px_y - 0.5f);
    const Ints tap_x = to_ints(left), tap_y = to_ints(top);
    const Ints whole = (tap_x >= 1) & (tap_y >= 1) & (tap_x < width - 2) & (tap_y < height - 2);
    const Ints right = tap_x + 1 < width, below = tap_y + 1 < height, none = (Ints)(0);
    const Ints within =
        1 | (right ? (Ints)(2) : none) | (below ? (Ints)(4) : none) | ((right & below) ? (Ints)(8) : none);
    const Samples samples = {.src = src,
                             .tap = tap_y * width + tap_x,
                             .alike = whole ? (Ints)(ALL_ALIKE) : within,
                             .u = px_x - 0.5f - left,
                             .v = px_y - 0.5f - top};
    resample_lanes(samples, LANE_NUMBERS < count, width, shown, dst, out_color);
}
