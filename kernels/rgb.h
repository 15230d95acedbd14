/* Colors of half images as three scalars. */

/* Three scalars, which compilers for CPUs spread over SIMD lanes three times better than a float3. */
typedef struct {
    float r, g, b;
} Rgb;

/* The half in the low 16 bits of `bits`; NaN counts as 0, infinities are clamped. */
INLINE float unpack_half(const uint bits) {
    const uint size = bits & 0x7fffu, finite = size > 0x7c00u ? 0u : min(size, 0x7bffu);
    return as_float(((bits & 0x8000u) << 16) | (finite << 13)) * 0x1p112f;
}

INLINE Rgb load_rgb(__global const uint2 *color, const int i) {
    const uint2 bits = color[i];
    const Rgb c = {unpack_half(bits.x), unpack_half(bits.x >> 16), unpack_half(bits.y)};
    return c;
}

/* The lesser and the greater of finite numbers: comparisons are cheaper than fmin and fmax, which must sort out NaN. */
INLINE float lesser(const float a, const float b) { return a < b ? a : b; }
INLINE float greater(const float a, const float b) { return a < b ? b : a; }
