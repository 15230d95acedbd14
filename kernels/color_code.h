/* Colors as they are mixed: in linear light, interpolation rings and smears beside highlights. The code of c is (c +
   2 o sqrt(c)) / 2 with c's sign: like a square root where it is dark, linear where it is bright. The frame block
   has `code_offset` o, which is half the root of the color that is displayed as 1; 0 stands for linear light, where
   a color is its own code. Above that color, w, the code continues as 3 w (c / w)^(1/4) - 2 w, with the same slope: a
   lamp that is displayed as white outweighs the pixels beside it no longer by all its brightness. */

/* What set it: docs/deviations.md, "Colors are mixed as they are seen". */
#define KNEE 3.0f /* with 3 the slope is continuous at w; less compresses more */

/* For colors of type F with the square root `roots`. */
#define DEFINE_COLOR_CODE(F, roots, some, encode, decode)                                                              \
    INLINE F encode(const F c, const float offset) {                                                                   \
        const F size = fabs(c), root = roots(size);                                                                    \
        const float white_root = 2.0f * offset, below = (KNEE - 1.0f) * white_root * white_root;                       \
        F code = 0.5f * size + offset * root;                                                                          \
        if (some(root > white_root))                                                                                   \
            code = root > white_root ? KNEE * white_root * roots(white_root * root) - below : code;                    \
        return offset > 0.0f ? copysign(code, c) : c;                                                                  \
    }                                                                                                                  \
    INLINE F decode(const F code, const float offset) {                                                                \
        const F size = fabs(code);                                                                                     \
        const float white_root = 2.0f * offset, white = white_root * white_root;                                       \
        const F sum = size + (KNEE - 1.0f) * white;                                                                    \
        F root = roots(2.0f * size + offset * offset) - offset;                                                        \
        if (some(size > white))                                                                                        \
            root = size > white ? sum * sum * divide(1.0f / (KNEE * KNEE), white * white_root) : root;                 \
        return offset > 0.0f ? copysign(root * root, code) : code;                                                     \
    }

DEFINE_ROOT(float3, roots)
DEFINE_COLOR_CODE(float3, roots, any, encode_color, decode_color)

/* The code of pixel i of the codes that are stored (color_code.cl), which are finite. */
INLINE float3 stored_code(__global const half *codes, const int i) { return load_texel(i, codes).xyz; }

/* The code of a pixel of an image in linear light. */
INLINE float3 load_code(__global const half *color, const int i, const float offset) {
    return encode_color(load_color(color, i), offset);
}

INLINE void store_code(const float3 code, __global half *color, const int i, const float offset) {
    store_color(decode_color(code, offset), color, i);
}

/* The code of the color that is displayed as white: the color itself, 1, where codes are linear. */
INLINE float display_white(const float code_offset) {
    return code_offset > 0.0f ? 4.0f * code_offset * code_offset : 1.0f;
}
