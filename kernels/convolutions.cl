/* The convolutions of the shading correction network (paper: 'Shading Correction Network'), in 8-bit integers, with the
   bits that onnxruntime gives for the same file.

   Images hold blocks of four channels, side by side in a uint, one image of a block after the other, with a border of
   one pixel of the byte that stands for 0. A byte q stands for (q - zero) * scale. Level l has 1/2^l of the sides of
   the network's frames. Sums of products of bytes are whole numbers below 2^24, so they are the same as `int` and as
   float (FLOAT_SUMS, for devices that are slow at integers), in any order. The first and the last convolution are in
   floats, in onnxruntime's order: for each pixel the sums over the weights of one input channel, from 0, added up, and
   then the bias. Sums are fused with their products, which is exact by the standard: `fma` rounds once. */

#include "frame.h"

#define BLOCK 4 /* channels that lie side by side */
#define BORDER 1
#define GROUP_WIDTH 32
#define GROUP_HEIGHT 2
#define GROUP_ITEMS 64 /* their product */
#define OUTPUT_ROWS 2 /* of pixels that a work-item makes */
#define MOST_READ 5 /* rows of inputs that it reads for them, where the image is halved */
#define KEPT_BLOCKS 12 /* of inputs, whose weights are in local memory at once */
#define MOST_TAPS 9 /* weights of an input for an output */
#define FIRST_PART 4 /* blocks of outputs that a work-item of the first convolution makes */
#define FIRST_PLANES 8 /* of its inputs */
#define FIRST_WEIGHTS 288 /* float4: of FIRST_PLANES inputs, MOST_TAPS each, for FIRST_PART blocks */
#define JUDGED_BLOCKS 5 /* of outputs of the last convolution */
#define JUDGED_INPUTS 8 /* blocks of inputs whose weights it has in local memory at once */
#define JUDGED_WEIGHTS 160 /* float4: of so many blocks of four inputs, for JUDGED_BLOCKS blocks */
#define LINE 64 /* work-items of a work-group of both */
#define ROUNDINGS 4 /* float4 of a layer's `numbers` before others: see `Rounded` */
#define ROUNDER                                                                                                        \
    12582912.0f /* 1.5 * 2^23: added and subtracted, it rounds to the nearest whole number, halves to even */

#define WITHIN_MASK 1 /* `asked` in correction.cl: the image is unchanged where the mask is 0 */

DEFINE_DIVIDE(float4, divide4)

/* A whole number of steps, within limits; the least for NaN. */
INLINE float4 stepped(const float4 v, const float least, const float most) {
    return (fmin(fmax(v, (float4)(least)), (float4)(most)) + ROUNDER) - ROUNDER;
}

/* Results of a layer, rounded. `numbers` begins with least and most of each rounding, and from the second on the
   factors for numbers from 0 on and below; then the zero points of both images. */
INLINE float4 first_steps(const float4 v, __constant float4 *numbers) {
    const float4 one = numbers[0], two = numbers[1], steps = stepped(v, one.x, one.y);
    return stepped(steps * (steps >= 0.0f ? (float4)(two.z) : (float4)(two.w)), two.x, two.y);
}

/* The same, rounded once more, for an image that is joined with another. */
INLINE float4 joined_steps(const float4 steps, __constant float4 *numbers) {
    const float4 three = numbers[2];
    return stepped(steps * (steps >= 0.0f ? (float4)(three.z) : (float4)(three.w)), three.x, three.y);
}

INLINE uint bytes_of(const float4 steps, const float zero) { return as_uint(convert_uchar4(steps + zero)); }

INLINE float4 leaky4(const float4 x, const float slope) { return fmax(x, slope * x); }

/* Where pixel (x, y) of an image of `pitch` - 2 pixels a row lies. */
INLINE int place_of(const int x, const int y, const int pitch) { return (y + BORDER) * pitch + x + BORDER; }

/* Whether nobody uses the judgement, because nothing changes. */
INLINE bool is_still(const int asked, __global const int *changed) { return asked == WITHIN_MASK && !*changed; }

/* Candidates as bytes: multiplied by a factor for each channel. */
__kernel void take(__constant Frame *restrict frame, const int asked, __global const int *changed,
                   __global const float *candidates, __constant float4 *numbers, __global uint *target) {
    if (is_still(asked, changed)) return;
    const int width = frame->network_width >> 1, height = frame->network_height >> 1, plane = width * height;
    const int x = get_global_id(0), y = get_global_id(1), block = get_global_id(2), pitch = width + 2 * BORDER;
    if (x >= width || y >= height) return;
    __global const float *in = candidates + BLOCK * block * plane + y * width + x;
    const float4 v = (float4)(in[0], in[plane], in[2 * plane], in[3 * plane]) * numbers[ROUNDINGS + block];
    const float4 zeros = numbers[3], steps = first_steps(divide4(v, (float4)(zeros.z)), numbers);
    target[block * pitch * (height + 2 * BORDER) + place_of(x, y, pitch)] = bytes_of(steps, zeros.x);
}

/* The first convolution, of frames, at half of their resolution: 3x3 in floats. A work-group shares its weights. */
__kernel __attribute__((reqd_work_group_size(LINE, 1, 1))) void
see(__constant Frame *restrict frame, const int asked, __global const int *changed, __global const float *frames,
    __global const float4 *weights, __constant float4 *numbers, __global uint *target) {
    __local float4 kept[FIRST_WEIGHTS];
    if (is_still(asked, changed)) return;
    const int width = frame->network_width >> 1, height = frame->network_height >> 1;
    const int x = get_global_id(0), y = get_global_id(1), part = get_global_id(2), pitch = width + 2 * BORDER;
    for (int i = get_local_id(0); i < FIRST_WEIGHTS; i += LINE) kept[i] = weights[part * FIRST_WEIGHTS + i];
    barrier(CLK_LOCAL_MEM_FENCE);
    if (x >= width) return;
    __local const float4 *w = kept;
    float4 sums[FIRST_PART];
#pragma unroll
    for (int b = 0; b < FIRST_PART; ++b) sums[b] = 0.0f;
    for (int c = 0; c < FIRST_PLANES; ++c, w += MOST_TAPS * FIRST_PART) {
        __global const float *in = frames + (c * 2 * height + 2 * y - 1) * 2 * width + 2 * x - 1;
        float4 of_channel[FIRST_PART];
#pragma unroll
        for (int b = 0; b < FIRST_PART; ++b) of_channel[b] = 0.0f;
#pragma unroll
        for (int t = 0; t < MOST_TAPS; ++t) {
            const bool is_inside = (t >= 3 || y > 0) && (t % 3 > 0 || x > 0);
            const float v = is_inside ? in[t / 3 * 2 * width + t % 3] : 0.0f;
#pragma unroll
            for (int b = 0; b < FIRST_PART; ++b) of_channel[b] = fma((float4)(v), w[t * FIRST_PART + b], of_channel[b]);
        }
#pragma unroll
        for (int b = 0; b < FIRST_PART; ++b) sums[b] += of_channel[b];
    }
    const float4 zeros = numbers[3];
    const int plane = pitch * (height + 2 * BORDER);
    target += part * FIRST_PART * plane + place_of(x, y, pitch);
#pragma unroll
    for (int b = 0; b < FIRST_PART; ++b) {
        const float4 sum = sums[b] + numbers[ROUNDINGS + part * FIRST_PART + b];
        const float4 v = divide4(leaky4(sum, zeros.w), (float4)(zeros.z));
        target[b * plane] = bytes_of(first_steps(v, numbers), zeros.x);
    }
}

#ifdef FLOAT_SUMS
typedef float4 Sums;
typedef float4 Inputs; /* of one pixel */
#define KEPT_PER_WEIGHTS 4
typedef float4 Kept; /* weights of one input for four outputs */
INLINE Inputs inputs_of(const uint bytes) { return convert_float4(as_uchar4(bytes)); }
INLINE float4 weights_of(const uint4 w, const int input) {
    const char4 x = as_char4(w.x >> (8 * input)), y = as_char4(w.y >> (8 * input));
    const char4 z = as_char4(w.z >> (8 * input)), last = as_char4(w.w >> (8 * input));
    return (float4)(x.x, y.x, z.x, last.x);
}
INLINE void keep(const uint4 w, __local Kept *kept) {
    for (int input = 0; input < BLOCK; ++input) kept[input] = weights_of(w, input);
}
/* Both forms give the same: sums are whole numbers that floats hold. */
#ifdef FP_FAST_FMAF
#define ADD_PRODUCT(a, b, sum) fma((float4)(a), b, sum)
#else
#define ADD_PRODUCT(a, b, sum) ((a) * (b) + (sum))
#endif
INLINE Sums added(const Sums sums, const Inputs v, __local const Kept *w) {
    return ADD_PRODUCT(v.w, w[3], ADD_PRODUCT(v.z, w[2], ADD_PRODUCT(v.y, w[1], ADD_PRODUCT(v.x, w[0], sums))));
}
INLINE float4 total_of(const Sums sums, const float4 bias) { return sums + bias; }
#else
typedef int4 Sums;
typedef uint Inputs;
#define KEPT_PER_WEIGHTS 1
typedef uint4 Kept; /* weights of four inputs for four outputs */
INLINE Inputs inputs_of(const uint bytes) { return bytes; }
INLINE void keep(const uint4 w, __local Kept *kept) { *kept = w; }
/* NVIDIA's compiler makes one instruction of this. */
INLINE int dot_of_bytes(const uint v, const uint w, const int sum) {
    const uchar4 a = as_uchar4(v);
    const char4 b = as_char4(w);
    return sum + a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w;
}
INLINE Sums added(const Sums sums, const Inputs v, __local const Kept *kept) {
    const uint4 w = *kept;
    return (int4)(dot_of_bytes(v, w.x, sums.x), dot_of_bytes(v, w.y, sums.y), dot_of_bytes(v, w.z, sums.z),
                  dot_of_bytes(v, w.w, sums.w));
}
INLINE float4 total_of(const Sums sums, const float4 bias) { return convert_float4(sums + convert_int4(bias)); }
#endif

/* A convolution with `size` weights each way, of an image of `source_blocks` blocks and of another of `beside_blocks`
   that is joined to it. A work-item makes OUTPUT_ROWS pixels of a block of channels, a work-group of 32 x 2 work-items
   shares their weights. `numbers` has, after the roundings, of each block of outputs the bias and the scale of sums.
   `again`: the image rounded once more, if `has_again`. */
INLINE void convolve(const int size, const int stride, __constant Frame *frame, __global const uint *source,
                     __global const uint *beside, __global const uint4 *weights, __constant float4 *numbers,
                     __global uint *target, __global uint *again, const int level, const int source_blocks,
                     const int beside_blocks, const int has_again, __local Kept *kept) {
    const int width = frame->network_width >> level, height = frame->network_height >> level;
    const int x = get_global_id(0), y = get_global_id(1) * OUTPUT_ROWS, target_block = get_global_id(2);
    const int taps = size * size, blocks = source_blocks + beside_blocks, first = BORDER - size / 2;
    const int pitch = stride * width + 2 * BORDER, last_row = stride * height + 2 * BORDER - 1;
    const int in_plane = pitch * (last_row + 1), in_x = stride * min(x, width - 1) + first;
    const int read = (OUTPUT_ROWS - 1) * stride + size;
    const int item = get_local_id(1) * GROUP_WIDTH + get_local_id(0);
    int places[MOST_READ];
    Sums sums[OUTPUT_ROWS];
#pragma unroll
    for (int j = 0; j < read; ++j) places[j] = min(stride * y + first + j, last_row) * pitch + in_x;
#pragma unroll
    for (int p = 0; p < OUTPUT_ROWS; ++p) sums[p] = 0;
    weights += target_block * blocks * taps;
    for (int from = 0; from < blocks; from += KEPT_BLOCKS, weights += KEPT_BLOCKS * taps) {
        const int count = min(KEPT_BLOCKS, blocks - from);
        barrier(CLK_LOCAL_MEM_FENCE); /* nobody reads the weights before these any more */
        for (int i = item; i < count * taps; i += GROUP_ITEMS) keep(weights[i], kept + KEPT_PER_WEIGHTS * i);
        barrier(CLK_LOCAL_MEM_FENCE);
        __local const Kept *w = kept;
        for (int block = from; block < from + count; ++block) {
            __global const uint *in =
                block < source_blocks ? source + block * in_plane : beside + (block - source_blocks) * in_plane;
#pragma unroll
            for (int i = 0; i < size; ++i) {
                Inputs v[MOST_READ];
#pragma unroll
                for (int j = 0; j < read; ++j) v[j] = inputs_of(in[places[j] + i]);
#pragma unroll
                for (int j = 0; j < size; ++j, w += KEPT_PER_WEIGHTS)
#pragma unroll
                    for (int p = 0; p < OUTPUT_ROWS; ++p) sums[p] = added(sums[p], v[p * stride + j], w);
            }
        }
    }
    if (x >= width) return;
    const int out_pitch = width + 2 * BORDER, plane = out_pitch * (height + 2 * BORDER);
    const float4 zeros = numbers[3];
    const float4 bias = numbers[ROUNDINGS + 2 * target_block], scale = numbers[ROUNDINGS + 2 * target_block + 1];
#pragma unroll
    for (int p = 0; p < OUTPUT_ROWS; ++p) {
        if (y + p >= height) break;
        const int at = target_block * plane + place_of(x, y + p, out_pitch);
        const float4 steps = first_steps(total_of(sums[p], bias) * scale, numbers);
        target[at] = bytes_of(steps, zeros.x);
        if (has_again) again[at] = bytes_of(joined_steps(steps, numbers), zeros.y);
    }
}

#define CONVOLUTION                                                                                                    \
    __constant Frame *restrict frame, const int asked, __global const int *changed,                                    \
        __global const uint *restrict source, __global const uint *restrict beside,                                    \
        __global const uint4 *restrict weights, __constant float4 *numbers, __global uint *restrict target,            \
        __global uint *restrict again, const int level, const int source_blocks, const int beside_blocks,              \
        const int has_again

/* Weights of 3x3 pixels. */
__kernel __attribute__((reqd_work_group_size(GROUP_WIDTH, GROUP_HEIGHT, 1))) void convolve3(CONVOLUTION) {
    __local Kept kept[KEPT_BLOCKS * MOST_TAPS * KEPT_PER_WEIGHTS];
    if (is_still(asked, changed)) return;
    convolve(3, 1, frame, source, beside, weights, numbers, target, again, level, source_blocks, beside_blocks,
             has_again, kept);
}

/* Weights of 3x3 pixels, to an image of half the size. */
__kernel __attribute__((reqd_work_group_size(GROUP_WIDTH, GROUP_HEIGHT, 1))) void halve3(CONVOLUTION) {
    __local Kept kept[KEPT_BLOCKS * MOST_TAPS * KEPT_PER_WEIGHTS];
    if (is_still(asked, changed)) return;
    convolve(3, 2, frame, source, beside, weights, numbers, target, again, level, source_blocks, beside_blocks,
             has_again, kept);
}

/* Weights of single pixels. */
__kernel __attribute__((reqd_work_group_size(GROUP_WIDTH, GROUP_HEIGHT, 1))) void convolve1(CONVOLUTION) {
    __local Kept kept[KEPT_BLOCKS * KEPT_PER_WEIGHTS];
    if (is_still(asked, changed)) return;
    convolve(1, 1, frame, source, beside, weights, numbers, target, again, level, source_blocks, beside_blocks,
             has_again, kept);
}

/* The numbers that bytes stand for, along one row from the left to the right neighbor of a pixel. */
typedef struct {
    float4 left, here, right;
} Triple;

INLINE Triple triple_of(__global const uint *row, const int left, const int x, const int right, const float4 input) {
    const Triple t = {input.x * (convert_float4(as_uchar4(row[left])) - input.y),
                      input.x * (convert_float4(as_uchar4(row[x])) - input.y),
                      input.x * (convert_float4(as_uchar4(row[right])) - input.y)};
    return t;
}

/* Weights of both neighbors that a doubled pixel lies between, the one before first: onnxruntime's, which are others
   at the ends. */
INLINE float2 weights_before(const int i, const int count) {
    const float first = count == 1 ? 0.5f : i == 0 ? 0.0f : 0.25f;
    return (float2)(first, 1.0f - first);
}
INLINE float2 weights_after(const int i, const int count) {
    const float first = i == count - 1 ? 0.5f : 0.75f;
    return (float2)(first, 1.0f - first);
}

/* Between four pixels, in onnxruntime's order. */
INLINE float4 between(const float4 a, const float4 b, const float4 c, const float4 d, const float2 wx,
                      const float2 wy) {
    return wx.x * wy.x * a + wx.y * wy.x * b + wx.x * wy.y * c + wx.y * wy.y * d;
}

/* An image of twice the size, bilinear. A work-item makes the four pixels of a pixel of the source. `numbers` has
   scale and zero point of the source after the roundings. */
__kernel void double_size(__constant Frame *restrict frame, const int asked, __global const int *changed,
                          __global const uint *restrict source, __constant float4 *numbers,
                          __global uint *restrict target, const int level) {
    if (is_still(asked, changed)) return;
    const int width = frame->network_width >> level, height = frame->network_height >> level;
    const int x = get_global_id(0), y = get_global_id(1), block = get_global_id(2), pitch = width + 2 * BORDER;
    if (x >= width || y >= height) return;
    const float4 zeros = numbers[3], input = numbers[ROUNDINGS];
    const int left = max(x - 1, 0), right = min(x + 1, width - 1);
    source += block * pitch * (height + 2 * BORDER) + BORDER;
    Triple rows[3];
#pragma unroll
    for (int j = 0; j < 3; ++j)
        rows[j] = triple_of(source + (clamp(y + j - 1, 0, height - 1) + BORDER) * pitch, left, x, right, input);
    const float2 wx[2] = {weights_before(x, width), weights_after(x, width)};
    const float2 wy[2] = {weights_before(y, height), weights_after(y, height)};
    const int out_pitch = 2 * width + 2 * BORDER;
    target += block * out_pitch * (2 * height + 2 * BORDER) + place_of(2 * x, 2 * y, out_pitch);
#pragma unroll
    for (int j = 0; j < 2; ++j) {
        const Triple above = rows[j], below = rows[j + 1];
        const float4 before = between(above.left, above.here, below.left, below.here, wx[0], wy[j]);
        const float4 after = between(above.here, above.right, below.here, below.right, wx[1], wy[j]);
        target[j * out_pitch] = bytes_of(first_steps(divide4(before, (float4)(zeros.z)), numbers), zeros.x);
        target[j * out_pitch + 1] = bytes_of(first_steps(divide4(after, (float4)(zeros.z)), numbers), zeros.x);
    }
}

/* The last convolution, of single pixels, in floats. A work-group shares its weights, those of one input channel after
   the other. `numbers`: scale and zero point of the source, and the bias. */
__kernel __attribute__((reqd_work_group_size(LINE, 1, 1))) void
judge_pixels(__constant Frame *restrict frame, const int asked, __global const int *changed,
             __global const uint *source, __global const float4 *weights, __constant float4 *numbers,
             __global float *judgement, const int source_blocks) {
    __local float4 kept[JUDGED_WEIGHTS];
    if (is_still(asked, changed)) return;
    const int width = frame->network_width >> 1, height = frame->network_height >> 1, plane = width * height;
    const int x = get_global_id(0), y = get_global_id(1), pitch = width + 2 * BORDER;
    const float4 input = numbers[0];
    source += place_of(min(x, width - 1), y, pitch);
    float4 sums[JUDGED_BLOCKS];
#pragma unroll
    for (int b = 0; b < JUDGED_BLOCKS; ++b) sums[b] = 0.0f;
    for (int from = 0; from < source_blocks; from += JUDGED_INPUTS) {
        const int count = min(JUDGED_INPUTS, source_blocks - from);
        barrier(CLK_LOCAL_MEM_FENCE); /* nobody reads the weights before these any more */
        for (int i = get_local_id(0); i < count * BLOCK * JUDGED_BLOCKS; i += LINE)
            kept[i] = weights[from * BLOCK * JUDGED_BLOCKS + i];
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int k = 0; k < count; ++k) {
            __local const float4 *w = kept + k * BLOCK * JUDGED_BLOCKS;
            const uint bytes = source[(from + k) * pitch * (height + 2 * BORDER)];
            const float4 v = input.x * (convert_float4(as_uchar4(bytes)) - input.y);
#pragma unroll
            for (int b = 0; b < JUDGED_BLOCKS; ++b) {
                sums[b] = fma((float4)(v.x), w[b], sums[b]);
                sums[b] = fma((float4)(v.y), w[JUDGED_BLOCKS + b], sums[b]);
                sums[b] = fma((float4)(v.z), w[2 * JUDGED_BLOCKS + b], sums[b]);
                sums[b] = fma((float4)(v.w), w[3 * JUDGED_BLOCKS + b], sums[b]);
            }
        }
    }
    if (x >= width) return;
    judgement += y * width + x;
#pragma unroll
    for (int b = 0; b < JUDGED_BLOCKS; ++b) {
        const float4 said = sums[b] + numbers[1 + b];
        judgement[BLOCK * b * plane] = said.x;
        judgement[(BLOCK * b + 1) * plane] = said.y;
        judgement[(BLOCK * b + 2) * plane] = said.z;
        judgement[(BLOCK * b + 3) * plane] = said.w;
    }
}
