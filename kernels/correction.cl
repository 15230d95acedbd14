/* Application of the shading correction network's judgement to the extrapolated frame (paper: 'Shading Correction
   Network'): the correction at half resolution, and the final image; and what follows the flow of the image. */

#include "frame.h"
#include "candidates.h"
#include "doubling.h"
#include "mu_law.h"
#include "sampling.h"
#include "simd_rgb.h"

/* What set the thresholds: docs/deviations.md, "The mask minimizes the error of the final frame", "Flickering light is
   left alone". */
#define LEAST_MASK 0.03125f  /* a smaller focus mask is 0 */
#define DETAIL 4             /* channels at half resolution, of which the network gives four pixels each */
#define JUDGED 4 /* channels before them: none (2), how far the found flow is followed, how long trends last */
#define SEEN 16 /* inputs of the head: detail (4), change along the flow (3), trend (3), both frames (6) */
#define HIDDEN 16 /* channels of its hidden layer */
#define SAID 6 /* outputs: change of color (3), detail that is kept, likelihood of the mask, share of the trend */
#define KEPT 3 /* channels of the correction, after its change of color: detail that is kept, ... */
#define MASK 4 /* ... focus mask */
#define SLOPE 0.1f /* of leaky rectifiers */
#define CHANGE_MARGIN 2.0f /* largest continued change of light, times its last change */
/* TRUSTED: of the focus mask: all while the last change differs by half of its square from the one before, ... */
#define TRUSTED 3.0f
#define DISTRUST 4.0f /* ... nothing from three quarters on */
#define DOUBT 0.1f /* the focus mask is 2 p - DOUBT */
#define FOLLOWED_SHARE 0.5f /* of a color that follows the flow; docs/deviations.md, "What the image flow explains" */
#define FOLLOWED_MARGIN 4.0f /* largest change by it, times the last one at half resolution */
#define FOLLOWED_ROWS 4 /* of a work-item: those of a pixel of a quarter of the resolution */

/* Bits of `asked`: whether the image is unchanged where the mask is 0, and whether `refined` is requested. */
#define WITHIN_MASK 1
#define WITH_REFINED 2

INLINE Floats leaky(const Floats x) { return wide_greater(x, SLOPE * x); }

/* 1 / (1 + exp(-x)); NaN stays NaN. */
INLINE Floats sigmoid(const Floats x) {
    const Floats of_negative = wide_divide((Floats)(1.0f), exp_less_one(wide_lesser(fabs(x), (Floats)(88.0f))) + 2.0f);
    const Floats value = x < 0.0f ? of_negative : 1.0f - of_negative;
    return x == x ? value : x;
}

/* Trust in the focus mask. It is low where light flickers, so that the last interval's change of brightness differs
   from that of the interval before, both in place and along the flow. */
INLINE Floats trust(__global const float *differences, const int plane, const Taps *taps) {
    const Floats changed = interpolate(differences, taps), again = interpolate(differences + 2 * plane, taps);
    const Floats again_along = interpolate(differences + 3 * plane, taps);
    const Floats ratio = wide_divide(wide_lesser(again, again_along) + LEAST, changed + LEAST);
    return clamp(TRUSTED - DISTRUST * ratio, (Floats)(0.0f), (Floats)(1.0f));
}

/* Chooses, at a quarter of the resolution, the flow to follow (2), in pixels of half the resolution, how far the trend
   lasts, and how far the focus mask is trusted. */
WIDE __kernel void choose_flow(__constant Frame *restrict frame, __global const float *judgement,
                               __global const float *candidates, __global const float *differences,
                               __global float *chosen) {
    const int width = frame->network_width / 2, height = frame->network_height / 2, plane = width * height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1);
    if (x >= width || y >= height) return;
    judgement += y * width + x;
    candidates += y * width + x;
    chosen += y * width + x;
    const Floats follow = 2.0f * FOUND_UNIT * frame->alpha * sigmoid(load_floats(0, judgement + 2 * plane));
    for (int axis = 0; axis < 2; ++axis)
        store_floats(follow * load_floats(0, candidates + (FOUND + axis) * plane), 0, chosen + axis * plane);
    const Floats lasts = load_floats(0, candidates + HELD * plane) + load_floats(0, judgement + 3 * plane);
    store_floats(lasts == lasts ? clamp(lasts, (Floats)(0.0f), (Floats)(1.0f)) : lasts, 0, chosen + 2 * plane);
    Taps taps;
    taps_around(x, y, width / 2, height / 2, &taps);
    store_floats(trust(differences, plane / 4, &taps), 0, chosen + 3 * plane);
}

/* The head: two layers of weights for each pixel. Weights lie one row after another, each layer's biases after them. */
INLINE void head_of(__constant float *head, const Floats *seen, Floats *said) {
    __constant float *bias = head + HIDDEN * SEEN, *second = bias + HIDDEN, *last = second + SAID * HIDDEN;
    for (int j = 0; j < SAID; ++j) said[j] = last[j];
    for (int k = 0; k < HIDDEN; k += 4) { /* four at once: what is seen is loaded once for all of them */
        __constant float *first = head + k * SEEN;
        Floats a = bias[k], b = bias[k + 1], c = bias[k + 2], d = bias[k + 3];
#pragma unroll
        for (int i = 0; i < SEEN; ++i) {
            a += first[i] * seen[i];
            b += first[SEEN + i] * seen[i];
            c += first[2 * SEEN + i] * seen[i];
            d += first[3 * SEEN + i] * seen[i];
        }
        a = leaky(a), b = leaky(b), c = leaky(c), d = leaky(d);
#pragma unroll
        for (int j = 0; j < SAID; ++j) {
            __constant float *w = second + j * HIDDEN + k;
            said[j] = said[j] + w[0] * a + w[1] * b + w[2] * c + w[3] * d;
        }
    }
}

/* Four pixels of a quarter of the resolution's planes make 2x2 pixels of half of it: those of the pixels from (x, y)
   on, of the planes of one channel. */
INLINE Floats load_detail(__global const float *planes, const int plane, const int x, const int y, const int width) {
    __global const float *row = planes + 2 * (y & 1) * plane + (y >> 1) * width;
    return load_in_turns(row, row + plane, x);
}

/* The difference `moved` between colors along the flow, within `margin` times what has changed since the previous frame
   here and there: texture is in both frames, so none of it moves along where light stays. */
INLINE Floats within_changes(const Floats moved, const Floats since, const Floats since_there, const float margin) {
    const Floats changed = margin * since, changed_there = margin * since_there;
    const Floats least = wide_lesser(wide_lesser(changed, changed_there), (Floats)(0.0f));
    const Floats most = wide_greater(wide_greater(changed, changed_there), (Floats)(0.0f));
    return within_limits(moved, least, most);
}

/* The difference between `now`, moved from a place along the flow, and the color here, within what changes. */
INLINE Floats moved_light(__global const float *frame_now, __global const float *frame_before, const Floats now,
                          const Floats before, const SampleRuns *along) {
    const Floats there = sampled_by_runs(frame_now, along);
    return within_changes(there - now, now - before, there - sampled_by_runs(frame_before, along), CHANGE_MARGIN);
}

/* Whether the focus mask is trusted anywhere in the 3x3 pixels around, of width by height, of half the size: elsewhere
   it is 0 for a pixel and its neighbors, and nobody uses the rest. */
INLINE Ints is_trusted_around(__global const float *trusted, const int width, const int height, const int x,
                              const int y) {
    Floats sum = 0.0f;
#pragma unroll
    for (int dy = -1; dy <= 1; ++dy) {
        __global const float *row = trusted + clamp((y >> 1) + dy, 0, height - 1) * width;
        const bool inner = LANES > 1 && x >= 2 && (x >> 1) + LANES / 2 < width;
        for (int dx = -1; dx <= 1; ++dx)
            sum += inner ? load_doubled(row + (x >> 1) + dx)
                         : gather_floats(row, clamp(((x + LANE_NUMBERS) >> 1) + dx, (Ints)(0), (Ints)(width - 1)));
    }
    return !(sum == 0.0f);
}

/* Judges at half resolution: change of encoded color (3), detail that is kept, focus mask. Texture is kept whatever the
   network says. Where nobody uses the result, it is no change, all detail, and no mask. */
WIDE __kernel void judge(__constant Frame *restrict frame, const int asked, __global const float *frames,
                         __global const float *trends, __global const float *judgement, __global const float *chosen,
                         __constant float *head, __global const float *texture, __global const int *changed,
                         __global float *correction) {
    const int width = frame->network_width, height = frame->network_height, plane = width * height, quarter = plane / 4;
    const int x = get_global_id(0) * LANES, y = get_global_id(1), at = y * width + x;
    if (x >= width || y >= height) return;
    correction += at;
    Ints used = ALL_LANES;
    if (asked == WITHIN_MASK && *changed)
        used = is_trusted_around(chosen + 3 * quarter, width / 2, height / 2, x, y);
    else if (asked == WITHIN_MASK)
        used = 0;
    if (!ANY(used)) {
        for (int c = 0; c < 5; ++c) store_floats((Floats)(c == KEPT ? 1.0f : 0.0f), 0, correction + c * plane);
        return;
    }
    Taps taps;
    taps_around(x, y, width / 2, height / 2, &taps);
    const Floats flow_x = interpolate(chosen, &taps), flow_y = interpolate(chosen + quarter, &taps);
    const Floats lasts = interpolate(chosen + 2 * quarter, &taps);
    SampleRuns along;
    find_sample_runs(row_indices(x) + flow_x, (float)y + flow_y, width, height, &along);
    Floats seen[SEEN], said[SAID];
    for (int c = 0; c < DETAIL; ++c)
        seen[c] = leaky(load_detail(judgement + (JUDGED + 4 * c) * quarter, quarter, x, y, width / 2));
    for (int c = 0; c < 3; ++c) {
        const Floats now = load_floats(0, frames + c * plane + at),
                     before = load_floats(0, frames + (3 + c) * plane + at);
        seen[DETAIL + c] = moved_light(frames + c * plane, frames + (3 + c) * plane, now, before, &along);
        seen[DETAIL + 3 + c] = interpolate(trends + c * quarter, &taps) * lasts;
        seen[DETAIL + 6 + c] = now;
        seen[DETAIL + 9 + c] = before;
    }
    head_of(head, seen, said);
    const Floats number = (flow_x - flow_x) + (flow_y - flow_y); /* 0; NaN for an invalid flow */
    for (int c = 0; c < 3; ++c) {
        const Floats change = said[c] + seen[DETAIL + c] + said[5] * seen[DETAIL + 3 + c] + number;
        store_floats(used ? change : (Floats)(0.0f), 0, correction + c * plane);
    }
    const Floats keep = sigmoid(said[3]), kept = keep + (1.0f - keep) * interpolate(texture, &taps);
    store_floats(used ? kept : (Floats)(1.0f), 0, correction + KEPT * plane);
    const Floats mask = *changed ? 2.0f * said[4] - DOUBT : (Floats)(0.0f);
    const Floats trusted = interpolate(chosen + 3 * quarter, &taps);
    const Floats shown = mask == mask ? clamp(mask, (Floats)(0.0f), (Floats)(1.0f)) * trusted : mask;
    store_floats(used ? shown : (Floats)(0.0f), 0, correction + MASK * plane);
}

/* Stores the lanes of a mixture that hold, and of the others the extrapolated color's own bits. */
INLINE void store_where(const Ints holds, const Wide4 c, const int count, __global const half *color,
                        __global half *out) {
    if (count >= LANES && ALL(holds)) {
        store_channels(c, count, out);
        return;
    }
    if (count >= LANES && !ANY(holds)) {
        copy_rgb_run(color, out);
        return;
    }
    for (int k = 0; k < min(count, LANES); ++k)
        if (int_of(&holds, k))
            store_color((float3)(float_of(&c.c[0], k), float_of(&c.c[1], k), float_of(&c.c[2], k)), out, k);
        else
            ((__global uint2 *)out)[k] = ((__global const uint2 *)color)[k];
}

/* Mixes the color `then` into `now`, as much as its share tells. */
INLINE void mix_in(const Wide4 then, const Floats share, Wide4 *now) {
    const Floats rest = 1.0f - share;
#pragma unroll
    for (int k = 0; k < 3; ++k) now->c[k] = now->c[k] * rest + then.c[k] * share;
    now->c[3] = 0.0f;
}

/* refined: the network's image, with the detail of the extrapolated one as the network decides; out_color: that
   within the focus mask, the extrapolated color's own bits where the mask is 0. Output that is not finite counts as
   no mask. `refined` is only stored on request; otherwise a run of pixels without mask is a copy. */
WIDE __kernel void correct(__constant Frame *restrict frame, const int asked, __global const half *color,
                           __global const float *frames, __global const float *correction, __global half *refined,
                           __global half *focus_mask, __global half *out_color) {
    const bool within_mask = asked & WITHIN_MASK, with_refined = asked & WITH_REFINED;
    const int target_width = frame->target_width, network_width = frame->network_width,
              network_height = frame->network_height;
    const float4 law = frame->color_law;
    const int x = get_global_id(0) * LANES, y = get_global_id(1);
    if (x >= target_width || y >= frame->target_height) return;
    const int i = y * target_width + x, plane = network_width * network_height, count = target_width - x;
    Taps taps;
    taps_around(x, y, network_width, network_height, &taps);
    const Floats m = interpolate(correction + MASK * plane, &taps);
    Wide4 made = {{0.0f, 0.0f, 0.0f, 0.0f}};
    if (within_mask && !with_refined && !ANY(m >= LEAST_MASK)) {
        store_some_halfs((Floats)(0.0f), count, focus_mask + i);
        store_where((Ints)(0), made, count, color + 4 * i, out_color + 4 * i);
        return;
    }
    Wide4 now = finite_rgb(load_some_channels(count, color + 4 * i));
    const Floats keep = interpolate(correction + KEPT * plane, &taps);
#pragma unroll
    for (int k = 0; k < 3; ++k) {
        const Floats low = interpolate(frames + k * plane, &taps), change = interpolate(correction + k * plane, &taps);
        made.c[k] = low + change + keep * (encode(now.c[k], law) - low);
    }
    const Ints usable = isfinite(made.c[0] + made.c[1] + made.c[2] + m);
    const Floats mask = (usable & (m >= LEAST_MASK)) ? wide_lesser(m, (Floats)(1.0f)) : (Floats)(0.0f);
    store_some_halfs(mask, count, focus_mask + i);
#pragma unroll
    for (int k = 0; k < 3; ++k) made.c[k] = decode(made.c[k], law);
    if (with_refined) store_where(usable, made, count, color + 4 * i, refined + 4 * i);
    const Floats whole = usable ? (Floats)(1.0f) : (Floats)(0.0f), share = within_mask ? mask : whole;
    mix_in(made, share, &now);
    store_where(share > 0.0f, now, count, color + 4 * i, out_color + 4 * i);
}

/* Whether any of the pixels of a quarter of the resolution between which those of the display from (x, y) on lie is
   `followed`, in FOLLOWED_ROWS rows. */
INLINE bool is_followed(__global const float *followed, const int width, const int height, const int x, const int y) {
    bool any_is = false;
    for (int row = (y >> 2) - 1; row <= (y >> 2) + 1; ++row)
        for (int column = (x >> 2) - 1; column <= ((x + LANES - 1) >> 2) + 1; ++column)
            any_is |= followed[clamp(row, 0, height - 1) * width + clamp(column, 0, width - 1)] > 0.0f;
    return any_is;
}

/* The places in an image 1 / `shrunk` as large of pixels from (x, y) on. */
INLINE void find_shrunk(const int x, const int y, const float shrunk, const int width, const int height, Sample *s) {
    const float scale = 1.0f / shrunk, offset = 0.5f * scale - 0.5f;
    find_sample(scale * row_indices(x) + offset, (Floats)(scale * (float)y + offset), width, height, s);
}

/* The change of a channel's encoded color since the previous frame. */
INLINE Floats change_since(__global const float *frames, const int plane, const Sample *s) {
    return sampled(frames, s) - sampled(frames + 3 * plane, s);
}

/* Moves the final image half way to the extrapolated color along the flow, where that is followed, as far as color
   changes. */
WIDE __kernel void follow_flow(__constant Frame *restrict frame, __global const half *extrapolated,
                               __global const float *frames, __global const float *flow, __global const float *followed,
                               __global half *color) {
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int fine = frame->network_width, fine_height = frame->network_height, plane = fine * fine_height;
    const int width = fine / 2, height = fine_height / 2;
    const float4 law = frame->color_law;
    const int x = get_global_id(0) * LANES, first = get_global_id(1) * FOLLOWED_ROWS, count = target_width - x;
    if (x >= target_width || first >= target_height || !is_followed(followed, width, height, x, first)) return;
    for (int y = first; y < min(first + FOLLOWED_ROWS, target_height); ++y) {
        Sample near, coarse, there, low, low_there;
        find_shrunk(x, y, 4.0f, width, height, &near);
        const Floats share = FOLLOWED_SHARE * sampled(followed, &near);
        find_shrunk(x, y, 8.0f, width / 2, height / 2, &coarse);
        const float pixels = 4.0f * frame->alpha; /* of the display, until t + alpha */
        const Floats from_x = row_indices(x) + pixels * sampled(flow, &coarse),
                     from_y = (float)y + pixels * sampled(flow + width * height / 4, &coarse);
        find_sample(from_x, from_y, target_width, target_height, &there);
        find_shrunk(x, y, 2.0f, fine, fine_height, &low);
        find_sample(0.5f * from_x - 0.25f, 0.5f * from_y - 0.25f, fine, fine_height, &low_there);
        const Ints below = there.tap + there.down;
        const Wide4 a = gather_channels(extrapolated, there.tap),
                    b = gather_channels(extrapolated, there.tap + there.right),
                    c = gather_channels(extrapolated, below), d = gather_channels(extrapolated, below + there.right);
        const int i = 4 * (y * target_width + x);
        Wide4 moved = finite_rgb(load_some_channels(count, extrapolated + i));
        __global const float *channel = frames;
#pragma unroll
        for (int k = 0; k < 3; ++k, channel += plane) {
            const Floats now = encode(moved.c[k], law),
                         from = encode(finite(between_taps(a.c[k], b.c[k], c.c[k], d.c[k], &there)), law);
            const Floats since = change_since(channel, plane, &low),
                         since_there = change_since(channel, plane, &low_there);
            moved.c[k] = decode(now + within_changes(from - now, since, since_there, FOLLOWED_MARGIN), law);
        }
        __global half *out = color + i;
        Wide4 now = finite_rgb(load_some_channels(count, out));
        mix_in(moved, share, &now);
        store_where(share > 0.0f, now, count, out, out);
    }
}
