/* Colours of half images, LANES pixels at once, as they are: finite_rgb makes numbers of what is none. */

#include "wide.h"

typedef struct { Floats r, g, b; } WideRgb;

/* NaN counts as 0, infinities are clamped. */
inline Floats finite(const Floats c) {
    const Floats number = c == c ? c : (Floats)(0.0f), low = number < -COLOR_MAX ? (Floats)(-COLOR_MAX) : number;
    return low < COLOR_MAX ? low : (Floats)(COLOR_MAX);
}

inline WideRgb finite_rgb(const WideRgb c) {
    const WideRgb rgb = {finite(c.r), finite(c.g), finite(c.b)};
    return rgb;
}

/* Colours of the pixels i. */
inline WideRgb gather_rgb(__global const half *color, const Ints i) {
    int pixel[LANES];
    float r[LANES], g[LANES], b[LANES];
    store_ints(i, 0, pixel);
    for (int k = 0; k < LANES; ++k) {
        const float4 c = vload_half4(pixel[k], color);
        r[k] = c.x;
        g[k] = c.y;
        b[k] = c.z;
    }
    const WideRgb rgb = {load_floats(0, r), load_floats(0, g), load_floats(0, b)};
    return rgb;
}

#if LANES == 8

/* Of a row, from the first on. */
inline WideRgb load_rgb_run(__global const half *color) {
    const float16 a = vload_half16(0, color), b = vload_half16(1, color);
    const WideRgb rgb = {(float8)(a.s048c, b.s048c), (float8)(a.s159d, b.s159d),
                         (float8)(a.s26ae, b.s26ae)};
    return rgb;
}

inline void store_rgb_run(const WideRgb c, __global half *color) {
    vstore_half16_rte((float16)(c.r.s0, c.g.s0, c.b.s0, 0.0f, c.r.s1, c.g.s1, c.b.s1, 0.0f, c.r.s2, c.g.s2, c.b.s2, 0.0f,
                                c.r.s3, c.g.s3, c.b.s3, 0.0f), 0, color);
    vstore_half16_rte((float16)(c.r.s4, c.g.s4, c.b.s4, 0.0f, c.r.s5, c.g.s5, c.b.s5, 0.0f, c.r.s6, c.g.s6, c.b.s6, 0.0f,
                                c.r.s7, c.g.s7, c.b.s7, 0.0f), 1, color);
}

inline void copy_rgb_run(__global const half *color, __global half *out) {
    vstore16(vload16(0, (__global const uint *)color), 0, (__global uint *)out);
}

/* Two numbers of each lane, which follow one another. */
typedef float16 Pairs;
#define load_pairs(p) vload16(0, p)
#define load_half_pairs(p) vload_half16(0, p)

#else

inline WideRgb load_rgb_run(__global const half *color) { return gather_rgb(color, 0); }

inline void store_rgb_run(const WideRgb c, __global half *color) {
    vstore_half4_rte((float4)(c.r, c.g, c.b, 0.0f), 0, color);
}

inline void copy_rgb_run(__global const half *color, __global half *out) {
    *(__global uint2 *)out = *(__global const uint2 *)color;
}

typedef float2 Pairs;
#define load_pairs(p) vload2(0, p)
#define load_half_pairs(p) vload_half2(0, p)

#endif
