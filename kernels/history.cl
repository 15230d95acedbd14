/* History tracking (paper: 'Motion estimation', appendix Algorithm 1). Positions are in the view space of the
   current rendered camera: P_0 follows from depth. P_1 of a dynamic fragment is where its motion points to, at the
   depth met there, which is all that is stored of it for k = 2; for more, P_1 ... P_{k-1} are. */

#include "frame.h"
#include "blocks.h"
#include "encode.h"
#include "lattices.h"
#include "scene_cuts.h"
#include "sharpness.h"
#include "thresholds.h"

/* What set the thresholds: docs/deviations.md, "Quantized motion is measured", "The surface met at x' is checked",
   "Camera-fixed objects stay in place in view space". */
#define RESIDUAL_BINS 64
#define RESIDUAL_FIRST_BIN 214   /* bits of 2^-20 >> 22: the squared residual of the first bin, in px^2 */
#define THRESHOLD_LOW 0.25f      /* px: the least and the greatest threshold that is found */
#define THRESHOLD_HIGH 4.0f
#define RESIDUAL_STRIDE 4        /* every 4th pixel of every 4th row is enough for a quantile */
#define RESIDUAL_ROWS 4          /* ... of which a work-item takes so many */
#define COUNT_GROUP 64                 /* work-items per work-group that counts: a row of SAMPLES_X samples */
#define SCATTER_DISTANCE 8       /* px, diagonally: near enough for one surface */
#define CAMERA_ERROR 0.75f       /* px: static points are off by less where the camera is a fit */
#define HISTOGRAMS 8 /* of residuals, of their changes, of steps by STEP_CLASSES, and of excess by LOOKUPS */
#define EXCESS ((HISTOGRAMS - LOOKUPS) * RESIDUAL_BINS) /* index of the first of excess */
#define ARRIVED (HISTOGRAMS * RESIDUAL_BINS) /* index of the number of work-groups that have added their counts */
#define SHARP (ARRIVED + 1) /* index of what sharpness.h adds up */
#define STEP_CLASSES 4 /* steps of motion in x where it is not negative, in x where it is, and the same for y */
#define STEP_FIRST 0x3e8 /* bits of 0.25 >> 20: the least step in px that counts; less is finer than any threshold */
#define STEP_NONE 0.0009765625f /* px: less is no step at all, but rounding */
#define STEP_SAMPLES 32 /* fewest pairs of vectors to determine a step */
#define QUANTIZED_LOW 0.125f /* px: the least threshold beside errors of quantization; CAMERA_ERROR: the greatest */
#define LOOKUPS 2 /* at most so many quantized vectors are added to one */

#define NO_MOTION 0.001f /* px: each component of less, with rounding, is within epsilon ... */
#define LEAST_THRESHOLD 0.01f /* ... if that is at least so much */
#define SEARCH_RADIUS 2 /* px around x' in which the right surface is looked for ... */
#define OUTSIDE 4.0f /* ... where x' lies no farther out of the image */
#define DEPTH_TOLERANCE 0.03f /* relative depth within which a surface is plausible for a fragment that stands ... */
#define FIXED_MOST 0.0625f /* px by which a camera-fixed fragment may move in the image ... */
#define FIXED_DEPTH 0.01f /* ... and relative change of its depth */
#define DEPTH_CHANGE_MOST 0.12f /* relative, in an interval, of a surface that fills the neighborhood of x' */

INLINE float squared_distance(const float2 a, const float2 b) {
    const float dx = a.x - b.x, dy = a.y - b.y;
    return dx * dx + dy * dy;
}

/* Residual x^ - x' of the static test at pixels; returns where it applies. */
INLINE Ints static_residual(const Ints src_x, const int src_y, const int width, const int height,
                            const Reprojection to_previous, __global const float *depth, __global const float2 *motion,
                            Floats *residual_x, Floats *residual_y, Floats *mv_x, Floats *mv_y) {
    const Ints there = src_x < (src_y < height ? width : 0);
    const Ints src = there ? src_y * width + src_x : (Ints)(0);
    const Floats z = gather_floats(depth, src), px_x = to_floats(src_x) + 0.5f, px_y = (float)src_y + 0.5f;
    *mv_x = gather_xy(motion, src, mv_y);
    const Wide3 px_static = wide_reproject(px_x, px_y, z, to_previous);
    *residual_x = px_static.x - (px_x + *mv_x);
    *residual_y = px_static.y - (px_y + *mv_y);
    return there & (z > 0.0f) & !isinf(z) & isfinite(*mv_x) & isfinite(*mv_y) & (px_static.z > 0.0f);
}

/* Adds 1 to those bins that are not negative. */
INLINE void count_bins(__local int *histogram, const Ints bin) {
    for (int k = 0; k < LANES; ++k)
        if (int_of(&bin, k) >= 0) atomic_inc(histogram + int_of(&bin, k));
}

/* Adds 1 to the bins of squared residuals. */
INLINE void count_residuals(__local int *histogram, const Ints counts, const Floats x, const Floats y) {
    const Ints bin = ((floats_as_ints(x * x + y * y) >> 22) & 0x3ff) - RESIDUAL_FIRST_BIN;
    count_bins(histogram, counts ? clamp(bin, (Ints)(0), (Ints)(RESIDUAL_BINS - 1)) : (Ints)(-1));
}

/* Adds 1 to the bins of differences of a component of motion, mv, between two places where static points would move
   into one direction, and the vectors do: bin 0 none, 1 less than the least step, then eight per octave; of negative
   motion in the next histogram. */
INLINE void count_steps(__local int *histogram, const Ints counts, const Floats mv, const Floats still,
                        const Floats near_mv, const Floats near_still) {
    const Floats step = fabs(mv - near_mv);
    const Ints bin =
        clamp(((floats_as_ints(step) + (1 << 19)) >> 20) - STEP_FIRST + 2, (Ints)(1), (Ints)(RESIDUAL_BINS - 1));
    const Ints found = step < STEP_NONE ? (Ints)(0) : bin;
    const Ints positive = counts & (still >= 0.0f) & (near_still >= 0.0f) & (mv >= 0.0f) & (near_mv >= 0.0f);
    const Ints negative = counts & (still < 0.0f) & (near_still < 0.0f) & (mv <= 0.0f) & (near_mv <= 0.0f);
    count_bins(histogram, positive ? found : (negative ? found + RESIDUAL_BINS : (Ints)(-1)));
}

INLINE int sum_of(__local const int *histogram, const int first) {
    int sum = 0;
#pragma unroll 1
    for (int b = first; b < RESIDUAL_BINS; ++b) sum += histogram[b];
    return sum;
}

/* The bin below whose upper bound `share` of a histogram's counts lie; *below: how many do. */
INLINE int quantile_bin(__local const int *histogram, const float share, int *below) {
    const float least = share * (float)sum_of(histogram, 0);
    *below = 0;
#pragma unroll 1
    for (int b = 0; b < RESIDUAL_BINS; ++b) {
        *below += histogram[b];
        if ((float)*below >= least) return b;
    }
    return RESIDUAL_BINS - 1;
}

/* Squared residual at which bin b begins, px^2. */
INLINE float bin_start(const int b) { return as_float((uint)(b + RESIDUAL_FIRST_BIN) << 22); }

/* epsilon from the residual, within [low, high] px: where the errors of static pixels end. From their lowest tenth
   on, bins belong to one population as long as the next two hold more than 1% of it: errors of rounding and of
   cameras are spread without a gap, whatever their size. At most 8 times the lower quartile, which belongs to static
   pixels as long as a quarter of the frame is static: moving objects are spread without a gap, too. If nearly all of
   the frame is off by more than a camera can be, and by the same, that is a mover that fills the frame, and the
   change of the residual is all the noise there is. */
INLINE float noise_threshold_squared(__local const int *histogram, const float low, const float high) {
    __local const int *changes = histogram + RESIDUAL_BINS;
    int below, count;
    if (!sum_of(histogram, 0)) return low * low;
    const int first = quantile_bin(histogram, 0.1f, &below), quartile = quantile_bin(histogram, 0.25f, &count);
    int last = first;
    for (; last + 2 < RESIDUAL_BINS && (float)(histogram[last + 1] + histogram[last + 2]) > 0.01f * (float)below;
         ++last)
        below += histogram[last + 1];
    float noise = fmin(bin_start(last + 1), 64.0f * bin_start(quartile + 1));
    if (bin_start(first) > CAMERA_ERROR * CAMERA_ERROR && sum_of(changes, 0)) {
        const float change = bin_start(quantile_bin(changes, 0.97f, &count) + 1);
        if (16.0f * change < bin_start(first)) noise = 16.0f * change;
    }
    return clamp(noise, low * low, high * high);
}

/* The step of a class of quantized motion, px (its bin's upper bound): in a grid of steps, neighbors differ by none
   or by whole ones. 0: not quantized. -1: too few vectors, or all alike, or hardly any. */
INLINE float step_of(__local const int *histogram) {
    const int pairs = sum_of(histogram, 0), steps = sum_of(histogram, 2);
    if (pairs < STEP_SAMPLES || histogram[0] == pairs) return -1.0f;
    if (20 * histogram[1] > pairs) return 0.0f;
    if (10 * histogram[0] < pairs) return -1.0f;
    for (int b = 2; b < RESIDUAL_BINS; ++b)
        if (50 * histogram[b] > steps) return as_float((uint)(2 * (b - 2 + STEP_FIRST) + 1) << 19);
    return 0.0f;
}

/* Steps of motion by class, px, or 0, where it is not quantized. A class of which no step is known has twice that of
   the other sign (half floats of 0.5 uv + 0.5 have twice the step above 0.5), or else twice that of the other
   component. Nothing is quantized if the camera explains motion more exactly: layers that move past each other
   differ by whole steps, too. */
INLINE void find_steps(__local const int *histogram, const float threshold_squared, __global float *motion_steps) {
    float least = INFINITY, steps[STEP_CLASSES];
    for (int c = 0; c < STEP_CLASSES; ++c) {
        steps[c] = step_of(histogram + c * RESIDUAL_BINS);
        if (steps[c] > 0.0f) least = fmin(least, steps[c]);
    }
    const int explained =
        threshold_squared <= fmax(THRESHOLD_LOW * THRESHOLD_LOW, 0.140625f * least * least); /* 3/4 of a half */
    for (int c = 0; c < STEP_CLASSES; ++c) {
        const float other = steps[c ^ 1] < 0.0f ? fmax(steps[c ^ 2], steps[c ^ 3]) : steps[c ^ 1];
        motion_steps[c] = explained ? 0.0f : fmax(steps[c] < 0.0f ? 2.0f * other : steps[c], 0.0f);
    }
}

/* The amount by which residuals exceed errors of quantization, `times` those of two classes, px: 0 where they do not;
   NaN stays. Which way vectors were rounded to 0 gives the motion of static points, mv + residual. */
INLINE Floats beyond(const Floats residual, const Floats mv, const float times, __global const float *of_classes) {
    const Floats error = times * (mv + residual < 0.0f ? (Floats)(of_classes[1]) : (Floats)(of_classes[0]));
    const Floats excess = fabs(residual) - error;
    return excess < 0.0f ? (Floats)(0.0f) : excess;
}

/* The groups that count in rows of sampled pixels. */
INLINE int counting_groups(const int width, const int height) {
    const int samples_x = RESIDUAL_STRIDE * LANES * COUNT_GROUP, samples_y = RESIDUAL_STRIDE * RESIDUAL_ROWS;
    return ((width + samples_x - 1) / samples_x) * ((height + samples_y - 1) / samples_y);
}

/* Adds a work-group's counts to those of all groups; then, in the last of the `groups` that does so, puts their sums
   into `counts`, leaves zeros for the next launch that counts, and gives true. A group counts itself only by the values
   that its additions return, which are never negative: so the last one misses none. */
INLINE bool add_counts(__local int *counts, const int count, const int groups, __local int *is_last,
                       __global int *pending) {
    const int item = get_local_id(0);
    int before = 0;
    if (item == 0) *is_last = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll 1
    for (int b = item; b < count; b += COUNT_GROUP)
        if (counts[b]) before |= atomic_add(pending + b, counts[b]);
    if (before < 0) *is_last = 1;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item == 0) *is_last = atomic_add(pending + ARRIVED, 1 + *is_last) == groups - 1;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (!*is_last) return false;
#pragma unroll 1
    for (int b = item; b < count; b += COUNT_GROUP) counts[b] = atomic_xchg(pending + b, 0);
    if (item == 0) atomic_xchg(pending + ARRIVED, 0);
    barrier(CLK_LOCAL_MEM_FENCE);
    return true;
}

INLINE bool is_quantized(__global const float *motion_steps) {
    return motion_steps[0] + motion_steps[1] + motion_steps[2] + motion_steps[3] != 0.0f;
}

/* epsilon in addition to errors of quantization: where the excess over them ends, as in noise_threshold_squared; of
   these errors few are near the largest, so 0.5% is enough. */
INLINE float excess_threshold_squared(__local const int *histogram) {
    int below, last = quantile_bin(histogram, 0.1f, &below);
    while (last + 1 < RESIDUAL_BINS && bin_start(last + 1) <= QUANTIZED_LOW * QUANTIZED_LOW) below += histogram[++last];
    const int low = last;
    for (; last + 2 < RESIDUAL_BINS && (float)(histogram[last + 1] + histogram[last + 2]) > 0.005f * (float)below;
         ++last)
        below += histogram[last + 1];
    return last == low ? QUANTIZED_LOW * QUANTIZED_LOW : fmin(bin_start(last + 1), CAMERA_ERROR * CAMERA_ERROR);
}

/* How many quantized vectors were added to one: two, if that brings more than a fortieth of the pixels within the
   errors. From histograms of the squared excess of residuals over the errors of one vector and of two. */
INLINE int lookups_of(__local const int *histogram) {
    int low = 0;
    while (bin_start(low) < QUANTIZED_LOW * QUANTIZED_LOW) ++low;
    const int more = sum_of(histogram, low) - sum_of(histogram + RESIDUAL_BINS, low);
    return 40 * more > sum_of(histogram, 0) ? LOOKUPS : 1;
}

/* Measures a subset of the pixels, before anything else is done with a rendered frame. The first row of
   work-groups writes its block. The next SAMPLES_Y, a sample per work-item, count those of a cut, cut_counts[row *
   COUNTS + what], and the last of them finds the sharpness. The others make histograms: of the squared residual, two
   bins per octave, of its squared change over a short distance, of every fourth of their pixels, of the steps of motion
   over that distance, and of the squared excess over errors of quantization by the steps of the frame before. From them
   the last work-group finds the threshold, these errors, and the steps for the next frame. */
WIDE __kernel __attribute__((reqd_work_group_size(COUNT_GROUP, 1, 1))) void
measure_samples(const Frame given, __global Frame *frame, __global const half *color, __global const float *depth,
                __global const float2 *motion, __global const half *color_prev, __global const float *depth_prev,
                __global const float *steps_prev, __global int *cut_counts, __global int *pending,
                __global int *histogram, __global float *threshold_squared, __global float *motion_steps,
                __global float *quantization_error, __global float *sharpness, __global float4 *layer,
                __global float4 *errors) {
    const int width = given.source_width, height = given.source_height, item = get_local_id(0);
    const int row = (int)get_global_id(1) - (SAMPLES_Y + 1), first = row * RESIDUAL_ROWS * RESIDUAL_STRIDE;
    __local int counts[HISTOGRAMS * RESIDUAL_BINS], is_last;
    if (get_global_id(1) == 0) { /* a row of its own: it takes many registers */
        if (get_global_id(0) == 0) *frame = given;
        return;
    }
    const int rows = (height + RESIDUAL_ROWS * RESIDUAL_STRIDE - 1) / (RESIDUAL_ROWS * RESIDUAL_STRIDE);
    if (row >= rows) {
        const int block = (row - rows) * (int)get_global_size(0) + (int)get_global_id(0);
        weigh_layers(block, &given, depth, color, color_prev, layer, errors);
        return;
    }
    if (row < 0 ? get_group_id(0) > 0 : !given.automatic) return;
    for (int b = item; b < HISTOGRAMS * RESIDUAL_BINS; b += COUNT_GROUP) counts[b] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    const int of_samples = row + SAMPLES_Y, groups = min(height, SAMPLES_Y);
    const bool compares = row < 0 && of_samples < groups && given.sharpness, detects = row < 0 && given.detects;
    if (detects)
        count_sample(item, of_samples, width, height, given.camera_step, given.to_previous, color, depth, motion,
                     color_prev, depth_prev, counts);
    if (compares)
        compare_sample(item, of_samples, width, height, given.code_offset, given.to_previous, color, depth, motion,
                       color_prev, depth_prev, counts + COUNTS);
    barrier(CLK_LOCAL_MEM_FENCE); /* PoCL skips tests of single work-items behind a barrier that is in a branch */
    if (detects && item < COUNTS) cut_counts[of_samples * COUNTS + item] = counts[item];
    if (compares && item == 0) find_sharpness(counts + COUNTS, groups, pending + SHARP, sharpness);
    if (row < 0) return;
    const Ints src_x = ((int)get_global_id(0) * LANES + LANE_NUMBERS) * RESIDUAL_STRIDE;
    const bool quantized = is_quantized(steps_prev);
    const int end = min(first + RESIDUAL_ROWS * RESIDUAL_STRIDE, height);
#pragma unroll 1
    for (int src_y = first; src_y < end; src_y += RESIDUAL_STRIDE) {
        Floats x, y, near_x, near_y, mv_x, mv_y, near_mv_x, near_mv_y;
        const Ints use =
            static_residual(src_x, src_y, width, height, given.to_previous, depth, motion, &x, &y, &mv_x, &mv_y);
        const Ints near_use =
            static_residual(src_x + SCATTER_DISTANCE, src_y + SCATTER_DISTANCE, width, height, given.to_previous, depth,
                            motion, &near_x, &near_y, &near_mv_x, &near_mv_y);
        count_residuals(counts, use, x, y);
        count_residuals(counts + RESIDUAL_BINS, use & near_use, x - near_x, y - near_y);
        for (int k = 1; quantized && k <= LOOKUPS; ++k)
            count_residuals(counts + EXCESS + (k - 1) * RESIDUAL_BINS, use,
                            beyond(x, mv_x, 0.5f * (float)k, steps_prev),
                            beyond(y, mv_y, 0.5f * (float)k, steps_prev + 2));
        if (src_y != first) continue;
        count_steps(counts + 2 * RESIDUAL_BINS, use & near_use, mv_x, mv_x + x, near_mv_x, near_mv_x + near_x);
        count_steps(counts + 4 * RESIDUAL_BINS, use & near_use, mv_y, mv_y + y, near_mv_y, near_mv_y + near_y);
    }
    if (!add_counts(counts, HISTOGRAMS * RESIDUAL_BINS, counting_groups(width, height), &is_last, pending)) return;
#pragma unroll 1
    for (int b = item; b < HISTOGRAMS * RESIDUAL_BINS; b += COUNT_GROUP) histogram[b] = counts[b];
    if (item) return;
    const float found = noise_threshold_squared(counts, THRESHOLD_LOW, THRESHOLD_HIGH);
    const int lookups = quantized ? lookups_of(counts + EXCESS) : 0;
    *threshold_squared = lookups ? excess_threshold_squared(counts + EXCESS + (lookups - 1) * RESIDUAL_BINS) : found;
    for (int c = 0; c < STEP_CLASSES; ++c) quantization_error[c] = 0.5f * (float)lookups * steps_prev[c];
    find_steps(counts + 2 * RESIDUAL_BINS, found, motion_steps);
}

INLINE bool plausible(const float z, const float z_expected, const float tolerance) {
    return !INVALID_DEPTH(z) && !isinf(z) && fabs(z - z_expected) <= tolerance;
}

/* Depth of the surface around px_prev in the previous frame: of four pixels, the likeliest by place and by either of
   two expected depths, with those alike; -1 where none is within the tolerance. That pixel is *nearest. */
INLINE float depth_at(const float2 px_prev, const float z_static, const float z_own, const float tolerance,
                      const int source_width, const int source_height, __global const float *depth_prev, int *nearest) {
    const float fx = px_prev.x - 0.5f, fy = px_prev.y - 0.5f;
    const int x0 = (int)floor(fx), y0 = (int)floor(fy);
    const float u = fx - (float)x0, v = fy - (float)y0;
    const bool are_inside = x0 >= 0 && y0 >= 0 && x0 < source_width - 1 && y0 < source_height - 1; /* all of them */
    float likeliest = 0.0f, z_met = -1.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = x0 + (tap & 1), tap_y = y0 + (tap >> 1);
        if (!are_inside && !inside(tap_x, tap_y, source_width, source_height)) continue;
        const float z = depth_prev[tap_y * source_width + tap_x];
        const float off = fmin(fabs(z - z_static), fabs(z - z_own));
        const float likely = bilinear_weight(tap, u, v) * (tolerance - off);
        if (INVALID_DEPTH(z) || !(likely > likeliest)) continue;
        likeliest = likely;
        z_met = z;
        *nearest = tap_y * source_width + tap_x;
    }
    if (!(z_met > 0.0f)) return -1.0f;
    float sum = 0.0f, weight_sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = x0 + (tap & 1), tap_y = y0 + (tap >> 1);
        if (!are_inside && !inside(tap_x, tap_y, source_width, source_height)) continue;
        const float z = depth_prev[tap_y * source_width + tap_x];
        if (!plausible(z, z_met, DEPTH_TOLERANCE * z_met)) continue;
        const float weight = bilinear_weight(tap, u, v);
        sum += weight * z;
        weight_sum += weight;
    }
    return divide(sum, weight_sum);
}

/* Depth of the fragment's surface in the previous frame at px_prev, or around it, where one is as expected within a
   tolerance; else -1. The pixel that has most of it is *nearest. */
INLINE float depth_met(const float2 px_prev, const float z_expected, const float tolerance, const int source_width,
                       const int source_height, __global const float *depth_prev, int *nearest) {
    const float z_met =
        depth_at(px_prev, z_expected, z_expected, tolerance, source_width, source_height, depth_prev, nearest);
    if (z_met > 0.0f) return z_met;
    const int near_x = (int)floor(px_prev.x), near_y = (int)floor(px_prev.y);
    float found = -1.0f, closest = INFINITY;
    for (int dy = -SEARCH_RADIUS; dy <= SEARCH_RADIUS; ++dy)
        for (int dx = -SEARCH_RADIUS; dx <= SEARCH_RADIUS; ++dx) {
            const int tap_x = near_x + dx, tap_y = near_y + dy;
            if (!inside(tap_x, tap_y, source_width, source_height)) continue;
            const float z = depth_prev[tap_y * source_width + tap_x];
            const float distance = squared_distance(pixel_center(tap_x, tap_y), px_prev);
            if (distance < closest && plausible(z, z_expected, tolerance)) {
                closest = distance;
                found = z;
                *nearest = tap_y * source_width + tap_x;
            }
        }
    if (found > 0.0f) return found;

    /* A surface that comes straight towards the camera: its depth changes without sideways motion. Believed where all
       four taps agree among themselves, so that x' cannot have slipped off an edge. */
    const float fx = px_prev.x - 0.5f, fy = px_prev.y - 0.5f;
    const int x0 = (int)floor(fx), y0 = (int)floor(fy);
    const float u = fx - (float)x0, v = fy - (float)y0;
    float low = INFINITY, high = -INFINITY, sum = 0.0f;
    for (int tap = 0; tap < 4; ++tap) {
        const int tap_x = x0 + (tap & 1), tap_y = y0 + (tap >> 1);
        if (!inside(tap_x, tap_y, source_width, source_height)) return -1.0f;
        const float z = depth_prev[tap_y * source_width + tap_x];
        if (!plausible(z, z_expected, DEPTH_CHANGE_MOST * z_expected)) return -1.0f;
        low = fmin(low, z);
        high = fmax(high, z);
        sum += bilinear_weight(tap, u, v) * z;
    }
    *nearest = (u < 0.5f ? y0 * source_width + x0 : y0 * source_width + x0 + 1) + (v < 0.5f ? 0 : source_width);
    return high - low <= DEPTH_TOLERANCE * low ? sum : -1.0f;
}

/* The rendered frame and the one before, and the results for dynamic fragments. */
typedef struct {
    __global const float *depth, *depth_prev;
    __global const float2 *motion;
    __global const uchar *dynamic_prev;
    __global const float4 *history_prev;
    __global float *met_depth;
    __global float4 *history;
} Frames;

/* The rest of Algorithm 1 for a dynamic fragment: P_1 ... from the previous frame. */
INLINE void find_history(const int src_x, const int src_y, __constant Frame *frame, const Frames f) {
    const int source_width = frame->source_width, plane = source_width * frame->source_height;
    const int src = src_y * source_width + src_x, positions = frame->positions;
    const Reprojection to_previous = frame->to_previous, from_previous = frame->from_previous;
    const float z = f.depth[src];
    const float2 mv_px = f.motion[src], px_prev = pixel_center(src_x, src_y) + mv_px;
    const float3 px_static = reproject(pixel_center(src_x, src_y), z, to_previous);
    int known = 0; /* how many of P_1 ... are known */
    f.met_depth[src] = 0.0f;
    if (px_prev.x > -OUTSIDE && px_prev.y > -OUTSIDE && px_prev.x < (float)source_width + OUTSIDE
        && px_prev.y < (float)frame->source_height + OUTSIDE) {
        const float sideways = (fabs(px_prev.x - px_static.x) + fabs(px_prev.y - px_static.y))
                               * from_previous.source_inverse.x * px_static.z;
        const float tolerance = DEPTH_TOLERANCE * px_static.z + DEPTH_PER_MOTION * sideways;
        int nearest = 0;
        /* At that of a static point or at its own, as of objects that travel with the camera, whichever is closer by;
           else at the depth of a point that moves sideways; else around, at its own. That looks at the four pixels in
           vain once more: without, it takes 11 registers more on gfx1030, and a quarter of the occupancy. */
        float z_prev = depth_at(px_prev, px_static.z, frame->camera_fixed ? z : px_static.z, DEPTH_TOLERANCE * z,
                                source_width, frame->source_height, f.depth_prev, &nearest);
#pragma unroll 1
        for (int own = 0; own <= frame->camera_fixed && !(z_prev > 0.0f); ++own) {
            const float expected = own ? z : px_static.z;
            if (expected > 0.0f)
                z_prev = depth_met(px_prev, expected, own ? DEPTH_TOLERANCE * z : tolerance, source_width,
                                   frame->source_height, f.depth_prev, &nearest);
        }
        if (z_prev > 0.0f) f.met_depth[src] = z_prev;
        if (z_prev > 0.0f && positions > 2) {
            const float3 p1_prev = unproject(px_prev, z_prev, from_previous.source_inverse);
            f.history[src] = (float4)(move_to_target(p1_prev, from_previous), 1.0f);
            known = 1;
            /* P_i[x] = P'_{i-1}[x'], carried over with the offset between x' and the pixel it is read from. */
            const float3 at_nearest = unproject(pixel_center(nearest % source_width, nearest / source_width),
                                                f.depth_prev[nearest], from_previous.source_inverse);
            const float3 offset = p1_prev - at_nearest;
            for (; known < positions - 1; ++known) {
                float4 older = (float4)(at_nearest, 1.0f);
                if (f.dynamic_prev[nearest]) older = f.history_prev[(known - 1) * plane + nearest];
                if (older.w == 0.0f) break;
                f.history[known * plane + src] = (float4)(move_to_target(older.xyz + offset, from_previous), 1.0f);
            }
        }
    }
    if (positions == 2) return;
    const float3 p0 = unproject(pixel_center(src_x, src_y), z, to_previous.source_inverse);
    for (int k = known; k < positions - 1; ++k) f.history[k * plane + src] = (float4)(p0, 0.0f);
}

/* Gives which of LANES fragments may be fixed to the camera: by their motion, and because static ones would have
   moved in the image (`moves`), or changed their depth. */
INLINE Ints may_be_fixed(const Floats px_x, const float px_y, const Floats mv_x, const Floats mv_y, const Floats z,
                         const Floats z_static, const Ints moves, __constant Frame *frame) {
    const Pinhole inverse = frame->to_previous.source_inverse, before = frame->to_previous.target;
    const Floats ex = before.x * ((px_x - inverse.z) * inverse.x) + before.z - (px_x + mv_x);
    const Floats ey = before.y * ((px_y - inverse.w) * inverse.y) + before.w - (px_y + mv_y);
    return (z > 0.0f) & !isinf(z) & (ex * ex + ey * ey <= FIXED_MOST * FIXED_MOST)
           & (moves | (fabs(z_static - z) > 2.0f * FIXED_DEPTH * z));
}

/* Whether such a fragment is: the frame before shows its surface there, no nearer and no farther. */
INLINE bool is_fixed(const int src_x, const int src_y, __constant Frame *frame, const Frames f) {
    const int src = src_y * frame->source_width + src_x;
    const float2 px_prev = pixel_center(src_x, src_y) + f.motion[src];
    const int x = clamp((int)floor(px_prev.x), 0, frame->source_width - 1);
    const int y = clamp((int)floor(px_prev.y), 0, frame->source_height - 1);
    return fabs(f.depth_prev[y * frame->source_width + x] - f.depth[src]) <= FIXED_DEPTH * f.depth[src];
}

/* The static test of LANES fragments: where static ones were in the frame before, how far the fragments' motion is from
   that, beyond errors of quantization where it exceeds the threshold, and whether they move. */
typedef struct {
    Wide3 px_static;
    Floats off_x, off_y;
    Ints moves;
} StaticTest;

INLINE StaticTest static_test(const Floats px_x, const Floats px_y, const Floats z, const Floats mv_x,
                              const Floats mv_y, const float threshold_squared,
                              __global const float *quantization_error, __constant Frame *frame) {
    StaticTest t;
    t.px_static = wide_reproject(px_x, px_y, z, frame->to_previous);
    t.off_x = t.px_static.x - (px_x + mv_x);
    t.off_y = t.px_static.y - (px_y + mv_y);
    t.moves = (z > 0.0f) & !isinf(z)
              & ((t.px_static.z < 0.0f) | !(t.off_x * t.off_x + t.off_y * t.off_y <= threshold_squared));
    if (ANY(t.moves)) { /* else nothing exceeds errors of quantization */
        t.off_x = beyond(t.off_x, mv_x, 1.0f, quantization_error);
        t.off_y = beyond(t.off_y, mv_y, 1.0f, quantization_error + 2);
        t.moves &= (t.px_static.z < 0.0f) | !(t.off_x * t.off_x + t.off_y * t.off_y <= threshold_squared);
    }
    return t;
}

/* Notes the frame's number in the blocks within STIR_REACH of pixels first_x to last_x of row y. */
INLINE void note_stir(const int first_x, const int last_x, const int src_y, __constant Frame *frame,
                      __global int *last_stir) {
    const int width = frame->source_width, height = frame->source_height;
    const int x0 = max(first_x - STIR_REACH, 0), x1 = min(last_x + STIR_REACH, width - 1);
    const int y0 = max(src_y - STIR_REACH, 0), y1 = min(src_y + STIR_REACH, height - 1);
    for (int by = y0 / BLOCK_HEIGHT; by <= y1 / BLOCK_HEIGHT; ++by)
        for (int bx = x0 / BLOCK_WIDTH; bx <= x1 / BLOCK_WIDTH; ++bx)
            last_stir[by * block_columns(width) + bx] = frame->number;
}

/* Algorithm 1. For dynamic fragments, met_depth: 0 if invalid; history, for k > 2: k-1 planes of (P_i, 1), or (P_0,
   0) where P_i is unknown. Static fragments only take the test. last_stir: for each block the number of the last frame
   in which a pixel within STIR_REACH of it was not static, had no valid depth or, while the camera rests, another depth
   than before. After a reset no steps of motion are known. Colors are encoded, too, unless the camera rests: then
   ColorCode encodes those that are mixed. */
WIDE __kernel void track_history(__constant Frame *restrict frame, __global const float *depth,
                                 __global const float2 *motion, __global const float *depth_prev,
                                 __global const uchar *dynamic_prev, __global const float4 *history_prev,
                                 __global const float *threshold_squared, __global const float *quantization_error,
                                 __global const half *color, __global uchar *dynamic_mask, __global float *met_depth,
                                 __global float4 *history, __global int *last_stir, __global half *codes,
                                 __global float *motion_steps, __global const float4 *layer,
                                 __global const float4 *errors, __global uchar *lattices, __global float4 *plane) {
    const Frames frames = {depth, depth_prev, motion, dynamic_prev, history_prev, met_depth, history};
    const int source_width = frame->source_width, source_height = frame->source_height;
    const int has_previous = frame->has_previous && frame->motion;
    const int src_x = get_global_id(0) * LANES, src_y = get_global_id(1);
    if (src_y >= source_height && frame->lattices && frame->has_previous) {
        const int block = (src_y - source_height) * (int)get_global_size(0) + (int)get_global_id(0);
        find_lattices(block, frame, layer, errors, lattices, plane);
    }
    if (src_x >= source_width || src_y >= source_height) return;
    const int src = src_y * source_width + src_x;
    const int count = min(source_width - src_x, LANES);
    for (int c = 0; !has_previous && src == 0 && c < STEP_CLASSES; ++c) motion_steps[c] = 0.0f;
    Ints moves = 0, may_stay = 0, stirs = 0;
    Floats z = 0.0f, mv_x = 0.0f, mv_y = 0.0f;
    if (has_previous) { /* before colors are encoded, so that GPUs need not wait for both */
        z = load_some_floats(count, depth + src);
        mv_x = load_some_xy(count, motion + src, &mv_y);
    }
    if (frame->coded) encode_run(count, src, frame->code_offset, color, codes);
    if (has_previous) {
        const Floats px_x = row_centers(src_x);
        const float px_y = (float)src_y + 0.5f;
        stirs = !(z > 0.0f);
        if (frame->rests) {
            const Floats z_prev = load_some_floats(count, depth_prev + src);
            stirs |= z != z_prev;
            const Ints may_move = stirs | !(fabs(mv_x) <= NO_MOTION) | !(fabs(mv_y) <= NO_MOTION);
            if (!ANY(may_move) && *threshold_squared >= LEAST_THRESHOLD * LEAST_THRESHOLD) {
                store_some_bytes((Bytes)(STATIC), count, dynamic_mask + src);
                return;
            }
        }
        const StaticTest test =
            static_test(px_x, (Floats)(px_y), z, mv_x, mv_y, *threshold_squared, quantization_error, frame);
        moves = test.moves;
        if (frame->camera_fixed) may_stay = may_be_fixed(px_x, px_y, mv_x, mv_y, z, test.px_static.z, moves, frame);
    }
    const Bytes mask = to_bytes(moves ? (Ints)(DYNAMIC) : (Ints)(STATIC));
    store_some_bytes(mask, count, dynamic_mask + src);
    if (!ANY(moves | may_stay | stirs)) return;
    int first = LANES, last = -1;
    for (int lane = 0; lane < count; ++lane) {
        const bool stays = int_of(&may_stay, lane) && is_fixed(src_x + lane, src_y, frame, frames);
        const bool is_dynamic = stays || int_of(&moves, lane);
        if (stays) dynamic_mask[src + lane] = FIXED_TO_CAMERA;
        if (is_dynamic) find_history(src_x + lane, src_y, frame, frames);
        if (!is_dynamic && !int_of(&stirs, lane)) continue;
        first = min(first, lane);
        last = lane;
    }
    if (last >= 0) note_stir(src_x + first, src_x + last, src_y, frame, last_stir);
}
