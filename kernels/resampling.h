/* Resampling of the rendered frame at any place: cubic, and bilinear over some of the taps, of colors' codes. One
   pixel, and LANES at once. */

#include "simd_rgb.h"
#include "color_code.h"
#include "cubic.h"

/* What set the constants: docs/deviations.md, "Edges are as sharp as earlier frames were". */
#define SHARPER_SLOPE 0.12f /* by how much the cubic's slope grows for a sharpness of 1 */
#define STEEPER 0.2f /* by how much an edge is steepened for a sharpness of 1, midway between pixels */
#define SHARP_AT_ONCE 2.0f /* times the measured sharpness at alpha = 0, ... */
#define LESS_SHARP_LATER 1.2f /* ... and less by this at 1: places are less certain */
#define FULL_RANGE 0.4f /* of colors, white being 1, between which edges are steepened in full */

/* How much sharper than Catmull-Rom's is interpolation. */
typedef struct {
    float slope; /* of the cubic */
    float steeper; /* by how much edges are steepened, midway between pixels */
    float per_range; /* 1 / the range of codes from which on they are so in full */
} Sharpening;

/* Of this sharpness. */
INLINE Sharpening sharpening(const float sharpness, const float code_offset) {
    const float white = code_offset > 0.0f ? 4.0f * code_offset * code_offset : 1.0f;
    const Sharpening s = {CATMULL_ROM + SHARPER_SLOPE * sharpness, STEEPER * sharpness,
                          divide(1.0f / FULL_RANGE, white)};
    return s;
}

/* Of a new frame after rendered ones of that sharpness (sharpness.cl). */
INLINE Sharpening sharpening_of(const float measured, __constant Frame *frame) {
    return sharpening(measured * fmax(SHARP_AT_ONCE - LESS_SHARP_LATER * frame->alpha, 0.0f), frame->code_offset);
}

/* 1 midway between pixels, 0 at their centers. */
#define MIDWAY(u, v) (1.0f - fabs(2.0f * (u) - 1.0f) * fabs(2.0f * (v) - 1.0f))

/* Images of the rendered frame that its fragments bring along. */
typedef struct {
    __global const half *color, *codes;
    __global const uchar *dynamic_mask;
    float code_offset;
    Sharpening sharpening;
} Rendered;

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

/* Where a pixel is resampled: at (u, v) from the pixel `tap`, next to the winner `src`. */
typedef struct {
    int src, tap, alike;
    float u, v;
} Sample;

/* Cubic where the neighborhood moves alike; else bilinear over those of the four taps that move alike. */
INLINE float3 resample(const Sample s, const int source_width, const Rendered shown) {
    if (s.tap == s.src && s.u == 0.0f && s.v == 0.0f) return load_color(shown.color, s.src);
    if (s.alike != ALL_ALIKE) return of_those_alike(s.alike, s.tap, s.u, s.v, source_width, s.src, shown);
    const Sharpening sharp = shown.sharpening;
    const float4 wx = cubic_weights(s.u, sharp.slope), wy = cubic_weights(s.v, sharp.slope);
    const float3 code = cubic(s.tap - source_width - 1, without_corners(wx, wy), wy, source_width, shown.codes,
                              sharp.steeper * MIDWAY(s.u, s.v), sharp.per_range);
    return decode_color(code, shown.code_offset);
}

#if LANES == 8
/* Sample of LANES pixels. */
typedef struct {
    Ints src, tap, alike;
    Floats u, v;
} Samples;
#else
typedef Sample Samples;
#endif

INLINE void samples_at(const Ints src, const Floats dx, const Floats dy, const int source_width, Samples *s) {
    const Floats ox = floor(dx), oy = floor(dy);
    s->src = src;
    s->tap = src + to_ints(oy) * source_width + to_ints(ox);
    s->alike = (Ints)(ALL_ALIKE);
    s->u = dx - ox;
    s->v = dy - oy;
}

#if LANES == 8
DEFINE_ROOT(Texels, texel_roots)

/* decode_texels is decode_color of four pixels. */
DEFINE_COLOR_CODE(Texels, texel_roots, encode_texels, decode_texels)

/* Four pixels in a row whose taps lie in a row from `tap` on; those that are a pixel of the rendered frame, `exact`,
   keep its bits. False where they are to be made one by one. */
INLINE bool resample_four(const int tap, const int4 exact, const float4 *wx, const float4 *wy, const float4 steeper,
                          const int source_width, const Rendered shown, __global half *out_color) {
    if (any(exact) && !all(exact)) return false;
    const Texels c = all(exact) ? vload_half16(0, shown.color + 4 * tap)
                                : decode_texels(cubic_of_run(tap - source_width - 1, wx, wy, source_width, shown.codes,
                                                             steeper, shown.sharpening.per_range),
                                                shown.code_offset);
    store_texels(WITHOUT_ALPHA(c), 0, out_color);
    return true;
}

/* Resamples halves whose taps lie in a row. Gives the lanes in `use` that are left. */
INLINE Ints resample_halves(const Samples s, const Ints use, const int source_width, const Rendered shown,
                            const int dst, __global half *out_color) {
    int lane_tap[LANES];
    Floats wx[4], wy[4];
    store_ints(s.tap, 0, lane_tap);
    wide_cubic_weights(s.u, shown.sharpening.slope, wx);
    wide_cubic_weights(s.v, shown.sharpening.slope, wy);
    const Floats steeper = shown.sharpening.steeper * MIDWAY(s.u, s.v);
    wide_without_corners(wx, wy);
    const Ints exact = (s.tap == s.src) & (s.u == 0.0f) & (s.v == 0.0f);
    const Ints whole = use & ((s.alike == ALL_ALIKE) | exact), in_row = s.tap - LANE_NUMBERS;
    const float4 left_x[4] = {wx[0].lo, wx[1].lo, wx[2].lo, wx[3].lo},
                 left_y[4] = {wy[0].lo, wy[1].lo, wy[2].lo, wy[3].lo};
    const float4 right_x[4] = {wx[0].hi, wx[1].hi, wx[2].hi, wx[3].hi},
                 right_y[4] = {wy[0].hi, wy[1].hi, wy[2].hi, wy[3].hi};
    const bool left =
        all(whole.lo & (in_row.lo == lane_tap[0]))
        && resample_four(lane_tap[0], exact.lo, left_x, left_y, steeper.lo, source_width, shown, out_color + 4 * dst);
    const bool right = all(whole.hi & (in_row.hi == lane_tap[4] - 4))
                       && resample_four(lane_tap[4], exact.hi, right_x, right_y, steeper.hi, source_width, shown,
                                        out_color + 4 * (dst + 4));
    return use & (Ints)((int4)(left ? 0 : -1), (int4)(right ? 0 : -1));
}
#else
#define resample_halves(s, use, source_width, shown, dst, out_color) (use)
#endif

/* The samples of the lanes in `use`. */
INLINE void resample_lanes(const Samples s, const Ints use, const int source_width, const Rendered shown, const int dst,
                           __global half *out_color) {
    const Ints rest = resample_halves(s, use, source_width, shown, dst, out_color);
    if (!ANY(rest)) return;
    int lane_rest[LANES], lane_tap[LANES], lane_alike[LANES], lane_src[LANES];
    float lane_u[LANES], lane_v[LANES];
    store_ints(rest, 0, lane_rest);
    store_ints(s.tap, 0, lane_tap);
    store_ints(s.alike, 0, lane_alike);
    store_ints(s.src, 0, lane_src);
    store_floats(s.u, 0, lane_u);
    store_floats(s.v, 0, lane_v);
    for (int k = 0; k < LANES; ++k) {
        if (!lane_rest[k]) continue;
        const Sample one = {
            .src = lane_src[k], .tap = lane_tap[k], .alike = lane_alike[k], .u = lane_u[k], .v = lane_v[k]};
        store_color(resample(one, source_width, shown), out_color, dst + k);
    }
}
