/* Cells of 4x4 pixels of a rendered frame, in which one mover's velocity and acceleration are known (see
   acceleration.cl). */

/* What set the thresholds: docs/deviations.md, "Movers' acceleration goes on". */
#define MOVER_CELL 4                 /* px each way */
/* CELL_TOLERANCE: relative depth within which a fragment, or another cell, belongs to the cell's mover */
#define CELL_TOLERANCE 0.05f

INLINE int mover_cell_of(const int x, const int y, const int width) {
    return y / MOVER_CELL * ((width + MOVER_CELL - 1) / MOVER_CELL) + x / MOVER_CELL;
}

INLINE bool is_of_cell(const float z, const float cell_depth) {
    return fabs(z - cell_depth) <= CELL_TOLERANCE * cell_depth;
}

/* A vector and its trust, 0 to 1 or -1 (unknown), in 64 bits: of each float sign, exponent and ten bits of the
   mantissa, then six bits; one is free. (Two words joined at 32 bits would become a funnel shift, which Oclgrind
   does not support.) */
#define UNKNOWN_TRUST 63u
#define MOST_TRUST 62

INLINE uint shortened(const float x) { return (as_uint(x) + 0x1000u) >> 13; }

INLINE uint2 packed(const float3 a, const float trust) {
    const uint x = shortened(a.x), y = shortened(a.y), z = shortened(a.z);
    const uint share = trust < 0.0f ? UNKNOWN_TRUST : (uint)(trust * (float)MOST_TRUST + 0.5f);
    return (uint2)(x | (y & 0xfffu) << 19, y >> 12 | z << 7 | share << 26);
}

INLINE bool is_trust_known(const uint2 p) { return p.y >> 26 != UNKNOWN_TRUST; }

INLINE bool is_trusted(const uint2 p) { return is_trust_known(p) && p.y >> 26; }

INLINE float trust_of(const uint2 p) {
    return is_trust_known(p) ? (float)(p.y >> 26) * (1.0f / (float)MOST_TRUST) : -1.0f;
}

INLINE float3 unpacked(const uint2 p) {
    return (float3)(as_float(p.x << 13), as_float((p.x >> 19 | (p.y & 127u) << 12) << 13),
                    as_float((p.y >> 7 & 0x7ffffu) << 13));
}
