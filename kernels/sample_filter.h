/* Weighted sums of the 3x3 rendered samples around pixels of the display (upscaling.cl). */

/* What set it: docs/upscaling.md, "Figures". */
#define FILTER_REACH 1.2f            /* display pixels: from where on a sample does not count */

/* Weights of three samples in a row, a rendered pixel apart, the middle one `off` display pixels away. */
INLINE void near_weights(const Floats off, const float size, Floats *weights) {
    for (int k = 0; k < 3; ++k) {
        const Floats t = (off + (float)(k - 1) * size) * (1.0f / FILTER_REACH),
                     left = wide_greater(1.0f - t * t, (Floats)(0.0f));
        weights[k] = left * left * left;
    }
}

/* Weights of three samples for interpolation between them; `off` in rendered pixels. */
INLINE void far_weights(const Floats off, Floats *weights) {
    const Floats within = within_limits(off, (Floats)(-1.0f), (Floats)(1.0f));
    for (int k = 0; k < 3; ++k) {
        const Floats t = within + (float)(k - 1), left = wide_greater(1.0f - t * t, (Floats)(0.0f));
        weights[k] = left * left;
    }
}

/* Weights of 3x3 samples: those of the columns, for each of LANES pixels of a row, and of the rows. */
typedef struct {
    Floats x[3];
    float3 y;
} Weights;

INLINE Weights weights_of(const Floats *x, const Floats *y) {
    const Weights w = {{x[0], x[1], x[2]}, (float3)(FIRST_LANE(y[0]), FIRST_LANE(y[1]), FIRST_LANE(y[2]))};
    return w;
}

INLINE float16 columns_of(const float3 wy, const float16 above, const float16 here, const float16 below) {
    return wy.x * above + wy.y * here + wy.z * below;
}

/* Weighted sums of a row of samples for the pixels of a part, whose columns start at these floats of `columns`. */
INLINE Texels rows_of(const Weights *w, const int part, const int *first, const float *columns) {
    Texels sum;
#pragma unroll
    for (int tap = 0; tap < 3; ++tap) {
        float texels[4 * TEXELS];
#pragma unroll
        for (int k = 0; k < TEXELS; ++k) vstore4(vload4(tap, columns + first[k]), k, texels);
        const Texels weighted = OF_TEXELS(w->x[tap], part) * reload_texels(0, texels);
        sum = tap == 0 ? weighted : sum + weighted;
    }
    return sum;
}

/* Weighted sums of the 3x3 samples around a pixel, a column at a time: all of them at once take 36 registers. */
INLINE void sums_of_one(const int x, const int y, float3 near_x, const float3 near_y, float3 far_x, const float3 far_y,
                        const int width, const int height, __global const half *compressed, float4 *near_sum,
                        float4 *far_sum) {
    const int above_row = clamp(y - 1, 0, height - 1) * width, below_row = clamp(y + 1, 0, height - 1) * width;
#pragma unroll 1
    for (int k = 0; k < 3; ++k) { /* near_x.x and far_x.x are the weights of this column */
        const int column = clamp(x + k - 1, 0, width - 1);
        const float4 above = load_texel(above_row + column, compressed),
                     here = load_texel(y * width + column, compressed),
                     below = load_texel(below_row + column, compressed);
        const float4 a = near_x.x * (near_y.x * above + near_y.y * here + near_y.z * below);
        const float4 b = far_x.x * (far_y.x * above + far_y.y * here + far_y.z * below);
        *near_sum = k == 0 ? a : *near_sum + a;
        *far_sum = k == 0 ? b : *far_sum + b;
        near_x = near_x.yzz;
        far_x = far_x.yzz;
    }
}

/* The weighted sum of the 3x3 samples around each of LANES pixels of a row, and one with other weights. */
INLINE Wide4 sums_around(const Ints x, const int y, const Weights near, const Weights far, const int width,
                         const int height, __global const half *compressed, Wide4 *far_sum) {
    const int first = FIRST_LANE(x);
    if (LANES > 1 && LAST_LANE(x) - first <= 9) { /* pixels are small, or of one size: they share columns */
        float near_columns[48], far_columns[48];
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            const float16 above = four_texels(compressed, first - 1 + 4 * k, y - 1, width, height),
                          here = four_texels(compressed, first - 1 + 4 * k, y, width, height),
                          below = four_texels(compressed, first - 1 + 4 * k, y + 1, width, height);
            vstore16(columns_of(near.y, above, here, below), k, near_columns);
            vstore16(columns_of(far.y, above, here, below), k, far_columns);
        }
        Strip s, t;
#pragma unroll
        for (int part = 0; part < PARTS; ++part) {
            int from[TEXELS];
            for (int k = 0; k < TEXELS; ++k) from[k] = 4 * (int_of(&x, part * TEXELS + k) - first);
            s.part[part] = rows_of(&near, part, from, near_columns);
            t.part[part] = rows_of(&far, part, from, far_columns);
        }
        *far_sum = channels_of_strip(&t);
        return channels_of_strip(&s);
    }
    float sums[4 * LANES], far_sums[4 * LANES];
    for (int k = 0; k < LANES; ++k) {
        const float3 near_x = (float3)(float_of(&near.x[0], k), float_of(&near.x[1], k), float_of(&near.x[2], k)),
                     far_x = (float3)(float_of(&far.x[0], k), float_of(&far.x[1], k), float_of(&far.x[2], k));
        float4 near_all, far_all;
        sums_of_one(int_of(&x, k), y, near_x, near.y, far_x, far.y, width, height, compressed, &near_all, &far_all);
        vstore4(near_all, k, sums);
        vstore4(far_all, k, far_sums);
    }
    *far_sum = channels_in(far_sums);
    return channels_in(sums);
}

INLINE Floats sum_of_weights(const Weights w) { return (w.x[0] + w.x[1] + w.x[2]) * (w.y.x + w.y.y + w.y.z); }
