/* Cubic (Catmull-Rom) interpolation of half images. */

/* Catmull-Rom weights of the four taps around t in [0, 1). */
inline float4 cubic_weights(const float t) {
    const float t2 = t * t, t3 = t2 * t;
    return (float4)(-0.5f * t + t2 - 0.5f * t3, 1.0f - 2.5f * t2 + 1.5f * t3, 0.5f * t + 2.0f * t2 - 1.5f * t3,
                    0.5f * t3 - 0.5f * t2);
}

/* Cubic interpolation of the 4x4 taps from (x0, y0) on, clamped to the four inner ones. `checked` taps are made finite;
   others are taken as they are, and so is what comes of them. */
inline float3 cubic(const int x0, const int y0, const float u, const float v, const int width, const bool checked,
                    __global const half *color) {
    const float4 wx4 = cubic_weights(u), wy4 = cubic_weights(v);
    const float wx[4] = {wx4.x, wx4.y, wx4.z, wx4.w}, wy[4] = {wy4.x, wy4.y, wy4.z, wy4.w};
    float3 sum = (float3)(0.0f), low = (float3)(INFINITY), high = (float3)(-INFINITY);
    for (int ty = 0; ty < 4; ++ty) {
        float3 row = (float3)(0.0f);
        for (int tx = 0; tx < 4; ++tx) {
            const int i = (y0 + ty) * width + x0 + tx;
            const float3 c = checked ? load_color(color, i) : vload_half4(i, color).xyz;
            row += wx[tx] * c;
            if (tx == 0 || tx == 3 || ty == 0 || ty == 3) continue;
            low = fmin(low, c);
            high = fmax(high, c);
        }
        sum += wy[ty] * row;
    }
    if (!checked && !(isfinite(sum.x) && isfinite(sum.y) && isfinite(sum.z))) return sum;
    return clamp(sum, low, high);
}
