/* Inputs of the shading correction network (paper: 'Shading Correction Network'): the previous rendered frame,
   warped, at full size; and the expected error of the extrapolated frame (not in the paper). */

#include "frame.h"
#include "warped_previous.h"

/* What set the weights: docs/deviations.md, "A mask of expected error". Of the expected squared error: */
#define LEAST_EXPECTED 0.00012f
#define OF_CONTRAST 0.0005f     /* times the squared contrast */
#define OF_CHANGE 0.09f         /* times contrast and change, twice alpha times, at the pixel, ... */
#define OF_CHANGE_AROUND 0.058f /* ... and around it */
#define OF_UNSEEN 0.012f        /* times the contrast where the surface was hidden at t-1, ... */
#define OF_HOLES 0.016f         /* ... more where t hides it, too, ... */
#define OF_FILLING 0.08f        /* ... and more where no stage knew it, ... */
#define FILLING 0.0015f         /* ... where even smooth color is a guess */
#define THIRD 0.33333334f
#define NINTH 0.11111111f
#define MASK_STEPS 1020.0f /* of the mask per unit of display values: quarters of an 8-bit level, up to MOST */
#define MOST 255.0f

/* warped_previous and input_mask. network_input (correction.cl) does not need them: it has the same from
   warped_previous.h. */
__kernel void prepare_inputs(__constant Frame *restrict frame, __global const half *color, __global const float *depth,
                             __global const float2 *out_motion, __global const uchar *is_dynamic,
                             __global const uchar *disoccluded, __global const float2 *motion,
                             __global const half *color_prev, __global const float *depth_prev,
                             __global half *warped_previous, __global half *input_mask) {
    const int dst_x = get_global_id(0), dst_y = get_global_id(1), dst = dst_y * frame->target_width + dst_x;
    if (dst_x >= frame->target_width || dst_y >= frame->target_height) return;
    const Frames frames = {frame, color, color_prev, depth, depth_prev, out_motion, motion, is_dynamic, disoccluded};
    vstore_half_rte(input_mask_at(&frames, dst), dst, input_mask);
    store_texel(previous_at(&frames, dst_x, dst_y), dst, warped_previous);
}

/* Values near to displayed ones: between c and sqrt(c) like sRGB, white is 1 and so is all above it. */
INLINE Wide4 shown_at(__global const half *color, const Ints at, const float exposure) {
    Wide4 c = finite_rgb(gather_channels(color, at));
#pragma unroll
    for (int k = 0; k < 3; ++k) {
        const Floats shown = clamp(exposure * c.c[k], (Floats)(0.0f), (Floats)(1.0f));
        c.c[k] = 0.5f * (shown + wide_root(shown));
    }
    return c;
}

/* The expected root-mean-square error of a pixel's display values, in MASK_STEPS, from the contrast around it, from
   what the frame before showed at its surface, and from the stage that filled it. Contrast is the range of 3x3 pixels,
   change the difference of both frames; means over the channels. */
WIDE __kernel void expect_error(__constant Frame *restrict frame, __global const half *color,
                                __global const half *warped_previous, __global const uchar *disoccluded,
                                __global const uchar *filled_by, __global uchar *expected_error) {
    const int width = frame->target_width, height = frame->target_height;
    const int x = get_global_id(0) * LANES, y = get_global_id(1);
    if (x >= width || y >= height) return;
    const Ints column = x + LANE_NUMBERS;
    Floats low[3], high[3], change = 0.0f, around = 0.0f, seen = 0.0f;
    for (int k = 0; k < 9; ++k) {
        const int row = clamp(y + k / 3 - 1, 0, height - 1) * width;
        const Ints at = row + clamp(column + (k % 3 - 1), (Ints)(0), (Ints)(width - 1));
        const Wide4 now = shown_at(color, at, frame->exposure), before = shown_at(warped_previous, at, frame->exposure);
        Floats differs = 0.0f;
#pragma unroll
        for (int c = 0; c < 3; ++c) {
            low[c] = k ? wide_lesser(low[c], now.c[c]) : now.c[c];
            high[c] = k ? wide_greater(high[c], now.c[c]) : now.c[c];
            differs += fabs(now.c[c] - before.c[c]);
        }
        differs = THIRD * differs;
        around += differs * differs;
        change = k == 4 ? differs : change;
        seen = k == 4 ? before.c[3] : seen;
    }
    const Floats contrast = THIRD * ((high[0] - low[0]) + (high[1] - low[1]) + (high[2] - low[2]));
    const int count = width - x, dst = y * width + x;
    const Ints hole = to_ints(load_some_bytes(count, disoccluded + dst)) != 0;
    const Ints filling = to_ints(load_some_bytes(count, filled_by + dst)) == BY_HOLE_FILLING;
    const Floats changes = OF_CHANGE * change + OF_CHANGE_AROUND * wide_root(NINTH * around);
    Floats weight = OF_CONTRAST * contrast + 2.0f * frame->alpha * changes;
    weight += seen > 0.0f ? (Floats)(0.0f) : (Floats)(OF_UNSEEN);
    weight += hole ? (Floats)(OF_HOLES) : (Floats)(0.0f);
    weight += filling ? (Floats)(OF_FILLING) : (Floats)(0.0f);
    const Floats squared = LEAST_EXPECTED + (filling ? (Floats)(FILLING) : (Floats)(0.0f)) + contrast * weight;
    const Floats levels = wide_lesser(MASK_STEPS * wide_root(squared) + 0.5f, (Floats)(MOST));
    store_some_bytes(to_bytes(to_ints(levels)), count, expected_error + dst);
}
