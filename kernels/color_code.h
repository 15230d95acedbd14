/* Colors as they are mixed: in linear light, interpolation rings and smears beside highlights. The code of c is (c +
   2 o sqrt(c)) / 2 with c's sign: like a square root where it is dark, linear where it is bright. The frame block
   has `code_offset` o, which is half the root of the color that is displayed as 1; 0 stands for linear light, where
   a color is its own code. */

DEFINE_ROOT(float3, roots)

INLINE float3 encode_color(const float3 c, const float offset) {
    const float3 size = fabs(c);
    return offset > 0.0f ? copysign(0.5f * size + offset * roots(size), c) : c;
}

INLINE float3 decode_color(const float3 code, const float offset) {
    const float3 root = roots(2.0f * fabs(code) + offset * offset) - offset;
    return offset > 0.0f ? copysign(root * root, code) : code;
}

/* The code of a pixel of an image in linear light. */
INLINE float3 load_code(__global const half *color, const int i, const float offset) {
    return encode_color(load_color(color, i), offset);
}

INLINE void store_code(const float3 code, __global half *color, const int i, const float offset) {
    store_color(decode_color(code, offset), color, i);
}
