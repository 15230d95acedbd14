/* The previous rendered frame at pixels of the extrapolated one (paper: I^w and M^input of 'Shading Correction
   Network'), for the kernels that store or sum it. Only pixels whose taps lie apart from their neighbors', or at the
   image's border, are processed one by one. */

#include "common.h"
#include "simd_rgb.h"

/* SAME_SURFACE: relative depth within which the surface met in the previous frame is the fragment's ... */
#define SAME_SURFACE 0.03f
#define DEPTH_PER_MOTION 2.0f /* ... and an addition per unit of its sideways motion, as in history tracking */
#define LEAST_WEIGHT 0.25f /* of the taps that show the surface */
#define MASK_DYNAMIC 1.0f
#define MASK_DISOCCLUDED 0.0f
#define MASK_REST 0.5f

/* The extrapolated frame, and the two rendered ones that its pixels are looked up in. `known`: whether there is one
   of t-1. */
typedef struct {
    int known, target_width, source_width, source_height;
    __global const half *color, *color_prev;
    __global const float *depth, *depth_prev;
    __global const float2 *out_motion, *motion;
    __global const uchar *is_dynamic, *disoccluded;
    __constant const Reprojection *to_previous;
} Frames;

/* Color of t-1 at a pixel's surface (see position_before), of the taps that show it; false where they show too
   little. */
INLINE bool color_before(const float3 before, const float tolerance, const int source_width, const int source_height,
                         __global const half *color_prev, __global const float *depth_prev, float3 *rgb) {
    const int x0 = (int)floor(before.x), y0 = (int)floor(before.y);
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = x0 + (tap & 1), tap_y = y0 + (tap >> 1);
        if (!inside(tap_x, tap_y, source_width, source_height)) continue;
        if (!is_same_surface(depth_prev[tap_y * source_width + tap_x], before.z, tolerance)) continue;
        const float weight = bilinear_weight(tap, before.x - (float)x0, before.y - (float)y0);
        sum += weight * load_color(color_prev, tap_y * source_width + tap_x);
        weight_sum += weight;
    }
    if (!(weight_sum >= LEAST_WEIGHT)) return false;
    *rgb = mean_of(sum, weight_sum);
    return true;
}

/* The positions where pixels of a row, of depth z, were at t-1 if they are static or were filled in: pixels of the
   previous image, less half a pixel, and depth there. reproject of common.h with fewer divisions. */
INLINE Wide3 position_before(const Floats px_x, const float px_y, const Floats z, const Reprojection r) {
    const Floats x = (px_x - r.source_inverse.z) * r.source_inverse.x, nearness = 1.0f / z; /* of the sky: 0 */
    const float y = (px_y - r.source_inverse.w) * r.source_inverse.y;
    const Floats depth = r.row2.x * x + (r.row2.y * y + r.row2.z) + r.row2.w * nearness, per_depth = 1.0f / depth;
    Wide3 before;
    before.x =
        r.target.x * (r.row0.x * x + (r.row0.y * y + r.row0.z) + r.row0.w * nearness) * per_depth + (r.target.z - 0.5f);
    before.y =
        r.target.y * (r.row1.x * x + (r.row1.y * y + r.row1.z) + r.row1.w * nearness) * per_depth + (r.target.w - 0.5f);
    before.z = depth * z;
    return before;
}

/* A strip of LANES pixels of a row, from the first of `count` that are left of it, which a row's last strip has
   fewer of: lanes beyond are the last pixel. */
typedef struct {
    int first, count;
    Floats px_x, depth;
    float px_y;
    Ints moves, hidden;
} StripOfFrame;

INLINE StripOfFrame strip_of_frame(const Frames *f, const int x, const int y) {
    const int first = y * f->target_width + x, count = f->target_width - x;
    StripOfFrame s;
    s.first = first;
    s.count = count;
    s.px_x = to_floats(min((Ints)(LANE_NUMBERS), (Ints)(count - 1))) + ((float)x + 0.5f);
    s.px_y = (float)y + 0.5f;
    s.depth = load_some_floats(count, f->depth + first);
    s.moves = to_ints(load_some_bytes(count, f->is_dynamic + first)) != 0;
    s.hidden = to_ints(load_some_bytes(count, f->disoccluded + first)) != 0;
    return s;
}

/* M^input. */
INLINE Floats input_mask_of(const StripOfFrame *s) {
    const Floats still = s->hidden ? (Floats)(MASK_DISOCCLUDED) : (Floats)(MASK_REST);
    return s->moves ? (Floats)(MASK_DYNAMIC) : still;
}

/* The places where a strip's pixels were at t-1. `tolerance`: in depth. Of those that are `inner`, all four taps are in
   the image, from tap_0 on. Of most strips they follow one another but for one jump, which the ends tell: they are
   those from `first` on, or, where in_second, from `second` on. */
typedef struct {
    Wide3 before; /* pixels, less half a pixel, and depth there: -1 where it is unknown */
    Floats tolerance, weight[4];
    Ints inner, tap_0, in_second, in_runs;
    int first, second;
} StripTaps;

/* Replaces the places of pixels that move, by the motion of both intervals. */
INLINE void follow_motion(const Frames *f, const StripOfFrame *s, StripTaps *t) {
    Floats mv_y;
    const Floats mv_x = load_some_xy(s->count, f->out_motion + s->first, &mv_y);
    const Floats x = s->px_x + mv_x, y = s->px_y + mv_y;
    const Ints in_image = (x >= 0.0f) & (x < (float)f->source_width) & (y >= 0.0f) & (y < (float)f->source_height);
    const Ints follows = s->moves & (t->before.z > 0.0f) & in_image;
    const Ints at = to_ints(follows ? y : (Floats)(0.0f)) * f->source_width + to_ints(follows ? x : (Floats)(0.0f));
    const Floats mv_before_x = gather_floats((__global const float *)f->motion, 2 * at);
    const Floats mv_before_y = gather_floats((__global const float *)f->motion, 2 * at + 1);
    const Ints known = follows & isfinite(mv_before_x) & isfinite(mv_before_y);
    const Floats x_before = x + mv_before_x - 0.5f, y_before = y + mv_before_y - 0.5f;
    const Floats sideways =
        (fabs(x_before - t->before.x) + fabs(y_before - t->before.y)) * (t->before.z / f->to_previous->target.x);
    t->tolerance = known ? t->tolerance + DEPTH_PER_MOTION * sideways : t->tolerance;
    t->before.x = known ? x_before : t->before.x;
    t->before.y = known ? y_before : t->before.y;
    t->before.z = (!s->moves | known) ? t->before.z : (Floats)(-1.0f);
}

INLINE void find_taps(const Frames *f, StripTaps *t) {
    const int width = f->source_width, height = f->source_height;
    const Wide3 before = t->before;
    t->inner = (before.z > 0.0f) & (before.x >= 0.0f) & (before.x < (float)(width - 1)) & (before.y >= 0.0f)
               & (before.y < (float)(height - 1));
    const Ints x0 = to_ints(t->inner ? before.x : (Floats)(0.0f)), y0 = to_ints(t->inner ? before.y : (Floats)(0.0f));
    const Floats u = before.x - to_floats(x0), v = before.y - to_floats(y0);
    const Ints tap_0 = y0 * width + x0;
    const int first = FIRST_LANE(tap_0), last = LAST_LANE(tap_0) - (LANES - 1), second = last >= 0 ? last : first;
    const Ints in_first = tap_0 == first + LANE_NUMBERS;
    t->weight[0] = (1.0f - u) * (1.0f - v);
    t->weight[1] = u * (1.0f - v);
    t->weight[2] = (1.0f - u) * v;
    t->weight[3] = u * v;
    t->tap_0 = tap_0;
    t->first = first;
    t->second = second;
    t->in_second = !in_first & (tap_0 == second + LANE_NUMBERS);
    t->in_runs = t->inner & (in_first | t->in_second);
}

/* Weights of taps that are of another surface become 0. The sum of the others. */
INLINE Floats weigh(const Frames *f, const bool all_in_runs, StripTaps *t) {
    const Floats z = t->before.z, nearest = isinf(z) ? z : z - t->tolerance, farthest = z + t->tolerance;
    Floats sum = 0.0f;
#pragma unroll
    for (int tap = 0; tap < 4; ++tap) {
        const int step = (tap & 1) + (tap >> 1) * f->source_width;
        Floats z_prev;
        if (all_in_runs) {
            z_prev = load_floats(0, f->depth_prev + t->first + step);
            if (t->second != t->first)
                z_prev = t->in_second ? load_floats(0, f->depth_prev + t->second + step) : z_prev;
        } else {
            const Ints at = t->inner ? t->tap_0 + step : (Ints)(0);
            z_prev = gather_floats(f->depth_prev, at);
        }
        const Ints same = t->inner & (z_prev >= nearest) & (z_prev <= farthest);
        t->weight[tap] = same ? t->weight[tap] : (Floats)(0.0f);
        sum += t->weight[tap];
    }
    return sum;
}

/* The sum, by weights, of taps that follow one another from `first` on. */
INLINE Strip sum_of_run(const int first, const StripTaps *t, const int width, __global const half *color) {
    const Strip a = load_strip(LANES, color + 4 * first), b = load_strip(LANES, color + 4 * (first + 1));
    const Strip c = load_strip(LANES, color + 4 * (first + width)),
                d = load_strip(LANES, color + 4 * (first + width + 1));
    Strip sum;
#pragma unroll
    for (int p = 0; p < PARTS; ++p)
        sum.part[p] = (OF_TEXELS(t->weight[0], p) * a.part[p] + OF_TEXELS(t->weight[2], p) * c.part[p])
                      + (OF_TEXELS(t->weight[1], p) * b.part[p] + OF_TEXELS(t->weight[3], p) * d.part[p]);
    return sum;
}

/* The weighted sum of taps that are in either of two runs. */
INLINE Strip sum_of_runs(const StripTaps *t, const int width, __global const half *color) {
    Strip sum = sum_of_run(t->first, t, width, color);
    if (t->second == t->first) return sum;
    const Strip other = sum_of_run(t->second, t, width, color);
#pragma unroll
    for (int p = 0; p < PARTS; ++p) sum.part[p] = WHERE_TEXELS(t->in_second, p) ? other.part[p] : sum.part[p];
    return sum;
}

/* Value of one pixel: (color of t-1, 1) by its taps of known weights where it is `weighted` and they are numbers, or
   by those of the surface; (GAE color, 0) where too few show it. */
INLINE float4 texel_before(const Frames *f, const int pixel, const bool lost, const bool weighted, const int tap_0,
                           const float4 weights, const float3 before, const float tolerance) {
    if (!lost && weighted) {
        __global const half *top = f->color_prev + 4 * tap_0, *bottom = top + 4 * f->source_width;
        const float4 sum = (weights.x * vload_half4(0, top) + weights.z * vload_half4(0, bottom))
                           + (weights.y * vload_half4(1, top) + weights.w * vload_half4(1, bottom));
        if (fabs(sum.x) <= COLOR_MAX && fabs(sum.y) <= COLOR_MAX && fabs(sum.z) <= COLOR_MAX)
            return (float4)(sum.xyz, 1.0f);
    }
    float3 rgb;
    if (!lost && color_before(before, tolerance, f->source_width, f->source_height, f->color_prev, f->depth_prev, &rgb))
        return (float4)(clamp(rgb, -COLOR_MAX, COLOR_MAX), 1.0f);
    return (float4)(load_color(f->color, pixel), 0.0f);
}

/* Values of the pixels `rest` of a strip. */
INLINE void look_one_by_one(const Frames *f, const StripOfFrame *s, const StripTaps *t, const Ints lost,
                            const Ints rest, Strip *out) {
    int lane_first[LANES], lane_weighted[LANES], lane_lost[LANES], lane_rest[LANES];
    float before_x[LANES], before_y[LANES], before_z[LANES], tolerances[LANES], weights[4][LANES], texels[4 * LANES];
    store_ints(t->tap_0, 0, lane_first);
    store_ints(t->inner, 0, lane_weighted);
    store_ints(lost, 0, lane_lost);
    store_ints(rest, 0, lane_rest);
    store_floats(t->before.x, 0, before_x);
    store_floats(t->before.y, 0, before_y);
    store_floats(t->before.z, 0, before_z);
    store_floats(t->tolerance, 0, tolerances);
    for (int tap = 0; tap < 4; ++tap) store_floats(t->weight[tap], 0, weights[tap]);
    for (int part = 0; part < PARTS; ++part) store_texels(out->part[part], part, texels);
    for (int k = 0; k < LANES; ++k) {
        if (!lane_rest[k]) continue;
        const float4 taps = (float4)(weights[0][k], weights[1][k], weights[2][k], weights[3][k]);
        const float3 place = (float3)(before_x[k], before_y[k], before_z[k]);
        vstore4(texel_before(f, s->first + min(k, s->count - 1), lane_lost[k], lane_weighted[k], lane_first[k], taps,
                             place, tolerances[k]),
                k, texels);
    }
    for (int part = 0; part < PARTS; ++part) out->part[part] = reload_texels(part, texels);
}

/* I^w of a strip: (color of t-1 at the pixel's surface, 1), or (GAE color, 0) where that was hidden or outside then.
   gae: the strip's colors. */
INLINE void previous_of(const Frames *f, const StripOfFrame *s, const Strip *gae, Strip *previous) {
    StripTaps taps;
    taps.before = position_before(s->px_x, s->px_y, s->depth, *f->to_previous);
    taps.tolerance = SAME_SURFACE * taps.before.z;
    if (ANY(s->moves)) follow_motion(f, s, &taps);
    if (!f->known) taps.before.z = -1.0f;
    find_taps(f, &taps);
    const bool runs_in_image =
        max(taps.first, taps.second) + LANES + f->source_width < f->source_width * f->source_height;
    const Floats weight_sum = weigh(f, runs_in_image && ALL(taps.in_runs | !taps.inner), &taps);
    const Ints shown = weight_sum >= LEAST_WEIGHT;
    if (!ALL(weight_sum > 0.99999f)) {
        const Floats scale = shown ? 1.0f / weight_sum : (Floats)(0.0f);
#pragma unroll
        for (int tap = 0; tap < 4; ++tap) taps.weight[tap] *= scale;
    }
    const Wide3 before = taps.before;
    const Ints met = (before.z > 0.0f) & (before.x > -1.0f) & (before.x < (float)f->source_width) & (before.y > -1.0f)
                     & (before.y < (float)f->source_height);
    const Ints lost = !met | (taps.inner & !shown);
    Ints rest = !lost & !(shown & taps.in_runs);
    Strip out = *gae;
    if (runs_in_image && !ALL(rest)) {
        out = sum_of_runs(&taps, f->source_width, f->color_prev);
        bool finite = true;
#pragma unroll
        for (int part = 0; part < PARTS; ++part) {
            VALID(out.part[part]) = 1.0f;
            if (ANY(lost)) {
                Texels own = gae->part[part];
                VALID(own) = 0.0f;
                out.part[part] = WHERE_TEXELS(lost, part) ? own : out.part[part];
            }
            finite &= ALL_TEXELS(fabs(out.part[part]) <= COLOR_MAX);
        }
        if (!finite) rest = ALL_LANES;
    } else {
        rest = ALL_LANES;
    }
    if (ANY(rest)) look_one_by_one(f, s, &taps, lost, rest, &out);
    *previous = out;
}
