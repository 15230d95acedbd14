/* Colors as RGB9E5: mantissas of 9 bits, R in the lowest, that share an exponent of 5 (as in
   EXT_texture_shared_exponent); negative ones become 0, large ones COLOR_MOST. */

#define COLOR_MOST 65408.0f     /* 511 * 2^7, the largest RGB9E5 */
#define COLOR_FINEST 1.52587890625e-5f  /* 2^-16: colors below that share the least exponent */

/* LANES colors. */
INLINE Ints pack_colors(const Floats r, const Floats g, const Floats b) {
    const Floats red = clamp(r, 0.0f, COLOR_MOST), green = clamp(g, 0.0f, COLOR_MOST),
                 blue = clamp(b, 0.0f, COLOR_MOST);
    const Floats most = fmax(fmax(red, green), fmax(blue, COLOR_FINEST));
    const Ints exponent = ((floats_as_ints(most) + 0x4000) >> 23) - 111;  /* 0 to 31, of the rounded `most` */
    const Floats scale = ints_as_floats((151 - exponent) << 23);
    return to_ints(rint(red * scale)) | to_ints(rint(green * scale)) << 9 | to_ints(rint(blue * scale)) << 18
           | exponent << 27;
}

/* One color, which takes all lanes. */
INLINE uint pack_color(const float3 c) {
    return (uint)FIRST_LANE(pack_colors((Floats)(c.x), (Floats)(c.y), (Floats)(c.z)));
}

INLINE float3 unpack_color(const uint bits) {
    const float unit = as_float(((bits >> 27) + 103u) << 23);  /* 2^(exponent - 24) */
    return convert_float3((uint3)(bits & 511u, (bits >> 9) & 511u, (bits >> 18) & 511u)) * unit;
}
