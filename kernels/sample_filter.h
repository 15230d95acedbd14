/* Weighted sums of the 3x3 rendered samples around pixels of the display (upscaling.cl). */

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
    const Floats within = wide_lesser(wide_greater(off, (Floats)(-1.0f)), (Floats)(1.0f));
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

#if LANES == 8

/* Weighted sums of a row of samples for four pixels, whose columns start at these floats of `columns`. */
INLINE float16 rows_of(const Weights *w, const int part, const int *first, const float *columns) {
    const float *a = columns + first[0], *b = columns + first[1], *c = columns + first[2], *d = columns + first[3];
    return OF_TEXELS(w->x[0], part) * (float16)(vload4(0, a), vload4(0, b), vload4(0, c), vload4(0, d))
           + OF_TEXELS(w->x[1], part) * (float16)(vload4(1, a), vload4(1, b), vload4(1, c), vload4(1, d))
           + OF_TEXELS(w->x[2], part) * (float16)(vload4(2, a), vload4(2, b), vload4(2, c), vload4(2, d));
}

#endif

/* The weighted sum of the 3x3 samples around each of LANES pixels of a row, and one with other weights. */
INLINE Wide4 sums_around(const Ints x, const int y, const Weights near, const Weights far, const int width,
                         const int height, __global const half *compressed, Wide4 *far_sum) {
#if LANES == 8
    int column[LANES];
    store_ints(x, 0, column);
    const int first = column[0] - 1;
    if (column[7] - first <= 10) {  /* pixels are small, or of one size: they share columns */
        float near_columns[48], far_columns[48];
#pragma unroll
        for (int k = 0; k < 3; ++k) {
            const float16 above = four_texels(compressed, first + 4 * k, y - 1, width, height),
                          here = four_texels(compressed, first + 4 * k, y, width, height),
                          below = four_texels(compressed, first + 4 * k, y + 1, width, height);
            vstore16(columns_of(near.y, above, here, below), k, near_columns);
            vstore16(columns_of(far.y, above, here, below), k, far_columns);
        }
        Strip s, t;
#pragma unroll
        for (int part = 0; part < PARTS; ++part) {
            int from[4];
            for (int k = 0; k < 4; ++k) from[k] = 4 * (column[4 * part + k] - column[0]);
            s.part[part] = rows_of(&near, part, from, near_columns);
            t.part[part] = rows_of(&far, part, from, far_columns);
        }
        Floats c[4], d[4];
        channels_of(&s, c);
        channels_of(&t, d);
        const Wide4 channels = {c[0], c[1], c[2], c[3]}, far_channels = {d[0], d[1], d[2], d[3]};
        *far_sum = far_channels;
        return channels;
    }
    float sums[4 * LANES], far_sums[4 * LANES], near_x[3][LANES], far_x[3][LANES];
    for (int k = 0; k < 3; ++k) {
        store_floats(near.x[k], 0, near_x[k]);
        store_floats(far.x[k], 0, far_x[k]);
    }
    for (int k = 0; k < LANES; ++k) {
        const float16 above = four_texels(compressed, column[k] - 1, y - 1, width, height),
                      here = four_texels(compressed, column[k] - 1, y, width, height),
                      below = four_texels(compressed, column[k] - 1, y + 1, width, height);
        const float16 a = columns_of(near.y, above, here, below), b = columns_of(far.y, above, here, below);
        vstore4(near_x[0][k] * a.s0123 + near_x[1][k] * a.s4567 + near_x[2][k] * a.s89ab, k, sums);
        vstore4(far_x[0][k] * b.s0123 + far_x[1][k] * b.s4567 + far_x[2][k] * b.s89ab, k, far_sums);
    }
    *far_sum = channels_in(far_sums);
    return channels_in(sums);
#else  /* a column at a time: all of them at once take 36 registers */
    float4 near_all = (float4)(0.0f), far_all = (float4)(0.0f);
    float3 near_x = (float3)(near.x[0], near.x[1], near.x[2]), far_x = (float3)(far.x[0], far.x[1], far.x[2]);
#pragma unroll 1
    for (int k = 0; k < 3; ++k) {  /* near_x.x and far_x.x are the weights of this column */
        const int column = clamp(x + k - 1, 0, width - 1);
        const float4 above = load_texel(clamp(y - 1, 0, height - 1) * width + column, compressed);
        const float4 here = load_texel(y * width + column, compressed);
        const float4 below = load_texel(clamp(y + 1, 0, height - 1) * width + column, compressed);
        const float4 a = near_x.x * (near.y.x * above + near.y.y * here + near.y.z * below);
        const float4 b = far_x.x * (far.y.x * above + far.y.y * here + far.y.z * below);
        near_all = k == 0 ? a : near_all + a;
        far_all = k == 0 ? b : far_all + b;
        near_x = near_x.yzz;
        far_x = far_x.yzz;
    }
    const Wide4 channels = {near_all.x, near_all.y, near_all.z, near_all.w};
    const Wide4 far_channels = {far_all.x, far_all.y, far_all.z, far_all.w};
    *far_sum = far_channels;
    return channels;
#endif
}

INLINE Floats sum_of_weights(const Weights w) { return (w.x[0] + w.x[1] + w.x[2]) * (w.y.x + w.y.y + w.y.z); }
