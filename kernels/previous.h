/* What shows of the previous rendered frame at pixels of the extrapolated one (paper: I^w and M^input of 'Shading Correction
   Network'), for the kernels that store or sum it. Only pixels whose taps lie apart from their neighbours', or at the image's
   border, are looked at one by one. */

#include "common.h"
#include "wide_rgb.h"

#define SAME_SURFACE 0.03f      /* relative depth within which the surface met in the previous frame is the fragment's ... */
#define DEPTH_PER_MOTION 2.0f   /* ... and what is added per unit of its sideways motion, as in history tracking */
#define LEAST_WEIGHT 0.25f      /* of the taps that show the surface */
#define MASK_DYNAMIC 1.0f
#define MASK_DISOCCLUDED 0.0f
#define MASK_REST 0.5f

/* The extrapolated frame, and the two rendered ones that its pixels are looked up in. `known`: whether there is one of t-1. */
typedef struct {
    int known, target_width, source_width, source_height;
    __global const half *color, *color_prev;
    __global const float *depth, *depth_prev;
    __global const float2 *out_motion, *motion;
    __global const uchar *is_dynamic, *disoccluded;
    Reprojection to_previous;
} Frames;

/* Colour of t-1 at a pixel's surface (see position_before), of the taps that show it; false where they show too little. */
inline bool color_before(const float3 before, const float tolerance, const int source_width, const int source_height,
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

/* Where pixels of a row, of depth z, were at t-1 if they are static or were filled in: pixels of the previous image, less half
   a pixel, and depth there. reproject of common.h with fewer divisions. */
inline Wide3 position_before(const Floats px_x, const float px_y, const Floats z, const Reprojection r) {
    const Floats x = (px_x - r.source_inverse.z) * r.source_inverse.x, nearness = 1.0f / z;  /* of the sky: 0 */
    const float y = (px_y - r.source_inverse.w) * r.source_inverse.y;
    const Floats depth = r.row2.x * x + (r.row2.y * y + r.row2.z) + r.row2.w * nearness, per_depth = 1.0f / depth;
    Wide3 before;
    before.x = r.target.x * (r.row0.x * x + (r.row0.y * y + r.row0.z) + r.row0.w * nearness) * per_depth + (r.target.z - 0.5f);
    before.y = r.target.y * (r.row1.x * x + (r.row1.y * y + r.row1.z) + r.row1.w * nearness) * per_depth + (r.target.w - 0.5f);
    before.z = depth * z;
    return before;
}

/* The same of those that move, by the motion of both intervals: z is -1 where it is unknown. *tolerance in depth. */
inline void follow_motion(const Ints moves, const Floats px_x, const Floats px_y, const Floats mv_x, const Floats mv_y,
                          const int source_width, const int source_height, __global const float2 *motion, const float focal,
                          Wide3 *before, Floats *tolerance) {
    const Floats x = px_x + mv_x, y = px_y + mv_y;
    const Ints in_image = (x >= 0.0f) & (x < (float)source_width) & (y >= 0.0f) & (y < (float)source_height);
    const Ints follows = moves & (before->z > 0.0f) & in_image;
    const Ints at = to_ints(follows ? y : (Floats)(0.0f)) * source_width + to_ints(follows ? x : (Floats)(0.0f));
    const Floats mv_before_x = gather_floats((__global const float *)motion, 2 * at);
    const Floats mv_before_y = gather_floats((__global const float *)motion, 2 * at + 1);
    const Ints known = follows & isfinite(mv_before_x) & isfinite(mv_before_y);
    const Floats x_before = x + mv_before_x - 0.5f, y_before = y + mv_before_y - 0.5f;
    const Floats sideways = (fabs(x_before - before->x) + fabs(y_before - before->y)) * (before->z / focal);
    *tolerance = known ? *tolerance + DEPTH_PER_MOTION * sideways : *tolerance;
    before->x = known ? x_before : before->x;
    before->y = known ? y_before : before->y;
    before->z = (!moves | known) ? before->z : (Floats)(-1.0f);
}

/* A strip of LANES pixels of a row, from the first of `count` that are left of it, which a row's last strip has fewer of: lanes
   beyond are the last pixel. */
typedef struct {
    int first, count;
    Floats px_x, depth;
    float px_y;
    Ints moves, hidden;
} StripOfFrame;

inline StripOfFrame strip_of_frame(const Frames *f, const int x, const int y) {
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
inline Floats input_mask_of(const StripOfFrame *s) {
    const Floats still = s->hidden ? (Floats)(MASK_DISOCCLUDED) : (Floats)(MASK_REST);
    return s->moves ? (Floats)(MASK_DYNAMIC) : still;
}

/* Where a strip's pixels were at t-1, less half a pixel, and depth there: -1 where that is unknown. *tolerance in depth. */
inline Wide3 strip_before(const Frames *f, const StripOfFrame *s, Floats *tolerance) {
    Wide3 before = position_before(s->px_x, s->px_y, s->depth, f->to_previous);
    *tolerance = SAME_SURFACE * before.z;
    if (ANY(s->moves)) {
        Floats mv_y;
        const Floats mv_x = load_some_xy(s->count, f->out_motion + s->first, &mv_y);
        follow_motion(s->moves, s->px_x, s->px_y, mv_x, mv_y, f->source_width, f->source_height, f->motion,
                      f->to_previous.target.x, &before, tolerance);
    }
    if (!f->known) before.z = -1.0f;
    return before;
}

/* Sum, by weights, of the taps of pixels whose 2x2 taps follow one another, from `first` on. */
inline Texels sum_of_run(const int part, const int first, const Texels *w, const int width, __global const half *color) {
    __global const half *top = color + 4 * (first + part * TEXELS), *bottom = top + 4 * width;
    return (w[0] * load_texels(0, top) + w[2] * load_texels(0, bottom))
           + (w[1] * load_texels(0, top + 4) + w[3] * load_texels(0, bottom + 4));
}

/* What one pixel shows: (colour of t-1, 1) by its taps of known weights where it is `weighted` and they are numbers, or by those
   of the surface; (GAE colour, 0) where too few show it. */
inline float4 texel_before(const Frames *f, const int pixel, const bool lost, const bool weighted, const int tap_0,
                           const float4 weights, const float3 before, const float tolerance) {
    if (!lost && weighted) {
        __global const half *top = f->color_prev + 4 * tap_0, *bottom = top + 4 * f->source_width;
        const float4 sum = (weights.x * vload_half4(0, top) + weights.z * vload_half4(0, bottom))
                           + (weights.y * vload_half4(1, top) + weights.w * vload_half4(1, bottom));
        if (fabs(sum.x) <= COLOR_MAX && fabs(sum.y) <= COLOR_MAX && fabs(sum.z) <= COLOR_MAX) return (float4)(sum.xyz, 1.0f);
    }
    float3 rgb;
    if (!lost && color_before(before, tolerance, f->source_width, f->source_height, f->color_prev, f->depth_prev, &rgb))
        return (float4)(clamp(rgb, -COLOR_MAX, COLOR_MAX), 1.0f);
    return (float4)(load_color(f->color, pixel), 0.0f);
}

/* I^w of a strip, as halfs: (colour of t-1 at the pixel's surface, 1), or (GAE colour, 0) where that was hidden or outside then.
   `gae`: the strip's colours. */
INLINE Strip previous_of(const Frames *f, const StripOfFrame *s, const Strip gae) {
    const int width = f->source_width, height = f->source_height;
    Floats tolerance;
    const Wide3 before = strip_before(f, s, &tolerance);
    const Ints inner = (before.z > 0.0f) & (before.x >= 0.0f) & (before.x < (float)(width - 1)) & (before.y >= 0.0f)
                       & (before.y < (float)(height - 1));
    const Ints x0 = to_ints(inner ? before.x : (Floats)(0.0f)), y0 = to_ints(inner ? before.y : (Floats)(0.0f));
    const Ints tap_0 = y0 * width + x0;
    const Floats u = before.x - to_floats(x0), v = before.y - to_floats(y0);

    /* The taps of most strips follow one another but for one jump, which the ends tell. */
    const int first = FIRST_LANE(tap_0), last = LAST_LANE(tap_0) - (LANES - 1), second = last >= 0 ? last : first;
    const Ints in_first = tap_0 == first + LANE_NUMBERS, in_second = !in_first & (tap_0 == second + LANE_NUMBERS);
    const Ints in_runs = inner & (in_first | in_second);
    const bool in_image = max(first, second) + LANES + width < width * height;
    const bool all_in_runs = in_image && ALL(in_runs | !inner);
    const Floats nearest = isinf(before.z) ? before.z : before.z - tolerance, farthest = before.z + tolerance;
    Floats weight[4], weight_sum = 0.0f;
#pragma unroll
    for (int tap = 0; tap < 4; ++tap) {
        const int step = (tap & 1) + (tap >> 1) * width;
        Floats z_prev;
        if (all_in_runs) {
            z_prev = load_floats(0, f->depth_prev + first + step);
            if (second != first) z_prev = in_second ? load_floats(0, f->depth_prev + second + step) : z_prev;
        } else {
            const Ints at = inner ? tap_0 + step : (Ints)(0);
            z_prev = gather_floats(f->depth_prev, at);
        }
        const Ints same = inner & (z_prev >= nearest) & (z_prev <= farthest);
        weight[tap] = same ? ((tap & 1) ? u : 1.0f - u) * ((tap >> 1) ? v : 1.0f - v) : (Floats)(0.0f);
        weight_sum += weight[tap];
    }
    const Ints shown = weight_sum >= LEAST_WEIGHT;
    if (!ALL(weight_sum > 0.99999f)) {
        const Floats scale = shown ? 1.0f / weight_sum : (Floats)(0.0f);
#pragma unroll
        for (int tap = 0; tap < 4; ++tap) weight[tap] *= scale;
    }
    const Ints met = (before.z > 0.0f) & (before.x > -1.0f) & (before.x < (float)width) & (before.y > -1.0f)
                     & (before.y < (float)height);
    const Ints lost = !met | (inner & !shown);
    Ints rest = !lost & !(shown & in_runs);
    Strip out = gae;
    if (!in_image || ALL(rest)) {
        rest = ALL_LANES;
    } else {
        int finite = 1;
#pragma unroll
        for (int part = 0; part < PARTS; ++part) {
            Texels w[4];
#pragma unroll
            for (int tap = 0; tap < 4; ++tap) w[tap] = OF_TEXELS(weight[tap], part);
            Texels sum = sum_of_run(part, first, w, width, f->color_prev);
            if (second != first) {
                const Texels other = sum_of_run(part, second, w, width, f->color_prev);
                sum = WHERE_TEXELS(in_second, part) ? other : sum;
            }
            VALID(sum) = 1.0f;
            if (ANY(lost)) {
                Texels own = gae.part[part];
                VALID(own) = 0.0f;
                sum = WHERE_TEXELS(lost, part) ? own : sum;
            }
            finite &= ALL_TEXELS(fabs(sum) <= COLOR_MAX);
            out.part[part] = sum;
        }
        if (!finite) rest = ALL_LANES;
    }
    if (ANY(rest)) {
        int lane_first[LANES], lane_weighted[LANES], lane_lost[LANES], lane_rest[LANES];
        float before_x[LANES], before_y[LANES], before_z[LANES], tolerances[LANES], weights[4][LANES], texels[4 * LANES];
        store_ints(tap_0, 0, lane_first);
        store_ints(inner, 0, lane_weighted);
        store_ints(lost, 0, lane_lost);
        store_ints(rest, 0, lane_rest);
        store_floats(before.x, 0, before_x);
        store_floats(before.y, 0, before_y);
        store_floats(before.z, 0, before_z);
        store_floats(tolerance, 0, tolerances);
        for (int tap = 0; tap < 4; ++tap) store_floats(weight[tap], 0, weights[tap]);
        for (int part = 0; part < PARTS; ++part) store_texels(out.part[part], part, texels);
        for (int k = 0; k < LANES; ++k) {
            if (!lane_rest[k]) continue;
            const float4 taps = (float4)(weights[0][k], weights[1][k], weights[2][k], weights[3][k]);
            const float3 place = (float3)(before_x[k], before_y[k], before_z[k]);
            vstore4(texel_before(f, s->first + min(k, s->count - 1), lane_lost[k], lane_weighted[k], lane_first[k], taps, place,
                                 tolerances[k]), k, texels);
        }
        for (int part = 0; part < PARTS; ++part) out.part[part] = reload_texels(part, texels);
    }
    return out;
}
