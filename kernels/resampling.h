/* Resampling of the rendered frame at LANES places: cubic, and bilinear over some of the taps, of colors' codes. */

#include "color_code.h"
#include "encode.h"
#include "cubic.h"

/* What set the constants: docs/deviations.md, "Edges are as sharp as earlier frames were". */
#define SHARPER_SLOPE 0.16f /* by how much the cubic's slope grows for a sharpness of 1 */
#define STEEPER 0.2f /* by how much an edge is steepened for a sharpness of 1, midway between pixels */

/* Of this sharpness, for codes with white as its own. */
INLINE Sharpening sharpening(const float sharpness, const float white) {
    const Sharpening sharp = {CATMULL_ROM + SHARPER_SLOPE * sharpness, true, STEEPER * sharpness,
                              divide(1.0f / (FULL_EDGE - LEAST_EDGE), white)};
    return sharp;
}

/* Images of the rendered frame that its fragments bring along. */
typedef struct {
    __global const half *color, *codes;
    __global const uchar *dynamic_mask;
    __global const float *sharpness; /* of rendered frames (sharpness.h), as far as it `is_measured` */
    float code_offset;
    bool is_measured;
} Rendered;

INLINE Rendered rendered_of(__constant Frame *frame, __global const half *color, __global const half *codes,
                            __global const uchar *dynamic_mask, __global const float *sharpness) {
    const bool is_measured = frame->sharpness && frame->has_previous;
    const Rendered shown = {color, codes, dynamic_mask, sharpness, frame->code_offset, is_measured};
    return shown;
}

#define ALL_ALIKE 0xFF  /* of taps that move alike: bits 0 to 3 the inner ones, 4 to 7 the corners */

/* Color at (u, v) from pixel `tap`, bilinear, of those of the four taps that move alike; else that of the winner. */
INLINE float3 of_those_alike(const int alike, const int tap, const float u, const float v, const int source_width,
                             const int winner, const Rendered shown) {
    float3 sum = (float3)(0.0f);
    float weight_sum = 0.0f;
    for (int k = 0; k < 4; ++k) {
        if (!((alike >> k) & 1)) continue;
        const float weight = bilinear_weight(k, u, v);
        sum += weight * stored_code(shown.codes, tap + (k >> 1) * source_width + (k & 1));
        weight_sum += weight;
    }
    return weight_sum > 0.01f ? decode_color(mean_of(sum, weight_sum), shown.code_offset)
                              : load_color(shown.color, winner);
}

/* Where LANES pixels are resampled: at (u, v) from the pixels `tap`, next to the winners `src`. */
typedef struct {
    Ints src, tap, alike;
    Floats u, v;
} Samples;

INLINE void samples_at(const Ints src, const Floats dx, const Floats dy, const int source_width, Samples *s) {
    const Floats ox = floor(dx), oy = floor(dy);
    s->src = src;
    s->tap = src + to_ints(oy) * source_width + to_ints(ox);
    s->alike = (Ints)(ALL_ALIKE);
    s->u = dx - ox;
    s->v = dy - oy;
}

#define ROWS_OF_TAPS(tap, width) {(tap) - (width), tap, (tap) + (width), (tap) + 2 * (width)}

/* Stores the colors of the lanes in `use`: a pixel of the rendered frame keeps its bits; cubic where the neighborhood
   moves alike; else bilinear over those of the four taps that move alike. A part whose taps lie in a row is made at
   once, others pixel by pixel. */
INLINE void resample_lanes(const Samples s, const Ints use, const int source_width, const Rendered shown, const int dst,
                           __global half *out_color) {
    Cubic cubic;
    cubic_between(s.u, s.v, sharpening(shown.is_measured ? *shown.sharpness : 0.0f, display_white(shown.code_offset)),
                  &cubic);
    const int columns[4] = {-1, 0, 1, 2};
    const Ints exact = (s.tap == s.src) & (s.u == 0.0f) & (s.v == 0.0f), whole = !exact & (s.alike == ALL_ALIKE);
    const Ints in_row = use & (s.tap == ROWS_OF_PARTS(s.tap));
#pragma unroll
    for (int part = 0; part < PARTS; ++part) {
        const int lane = part * TEXELS, first = int_of(&s.tap, lane);
        const bool copied = ALL_OF_PART(in_row & exact, part);
        if (copied || ALL_OF_PART(in_row & whole, part)) {
            const int rows[4] = ROWS_OF_TAPS(first, source_width);
            Texels c = copied ? load_texels(0, shown.color + 4 * first)
                              : cubic_of_run(columns, rows, &cubic, part, shown.codes);
            VALID(c) = 0.0f;
            if (!copied) c = decode_texels(c, shown.code_offset);
            VALID(c) = 0.0f;
            store_texels(c, 0, out_color + 4 * (dst + lane));
            continue;
        }
        for (int k = lane; k < lane + TEXELS; ++k) {
            if (!int_of(&use, k)) continue;
            const int tap = int_of(&s.tap, k), src = int_of(&s.src, k);
            float3 c;
            if (LANES > 1 && int_of(&exact, k)) {
                c = load_color(shown.color, src);
            } else if (LANES > 1 && int_of(&whole, k)) {
                const int rows[4] = ROWS_OF_TAPS(tap, source_width);
                c = decode_color(cubic_of_lane(columns, rows, &cubic, k, shown.codes).xyz, shown.code_offset);
            } else {
                c = of_those_alike(int_of(&s.alike, k), tap, float_of(&s.u, k), float_of(&s.v, k), source_width, src,
                                   shown);
            }
            store_color(c, out_color, dst + k);
        }
    }
}
