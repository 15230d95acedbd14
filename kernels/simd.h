/* Several pixels of a row per work-item. LANES is 8 on CPUs, whose compilers do not vectorize these kernels by
   themselves, and 1 on GPUs. The same source serves both:
   - Floats, Ints, Uints and Bytes hold one value per lane. With LANES 1 they are plain scalars.
   - A comparison of Floats gives Ints: -1 or 0 with 8 lanes, 1 or 0 with one. Test with ANY and ALL. Never add or
     compare it.
   - Select with `condition ? a : b`. Combine conditions with &, | and !, never with && and ||.
   - The last work-item of a row may have fewer pixels: load_some_... and store_some_... take their `count`. Loads
     repeat the last pixel, stores skip the rest.
   - wide_X is X of common.h for all lanes, with the same bits (wide_reproject_roughly: nearly). A rare pixel goes
     through the function of one pixel, lane by lane.
   - RUN bytes of masks at once are for kernels that find little to do: whether all are 0, whether any has a value. */

#if LANES == 8

#define WIDE __attribute__((vec_type_hint(float8)))  /* before a kernel: it is wide already */
#define LISTS WIDE /* before one for all pixels that appends to a list: on GPUs their groups must be known */
typedef float8 Floats;
typedef int8 Ints;    /* of conditions: -1 or 0 */
typedef uint8 Uints;
typedef uchar8 Bytes;
#define ANY(condition) any_of_lanes(condition)
#define ALL(condition) all_of_lanes(condition)
#define ANY_BYTE(bytes) (as_ulong(bytes) != 0)
#define load_floats vload8
#define load_bytes vload8
#define load_uints(i, p) vload8(i, p)
#define store_floats vstore8
#define store_bytes vstore8
#define store_halfs(v, i, p) vstore_half8_rte(v, i, p)
#define to_floats convert_float8
#define to_ints convert_int8
#define to_uints convert_uint8
#define to_bytes convert_uchar8
#define ints_as_floats as_float8
#define floats_as_ints as_int8
typedef float16 Pairs;       /* of numbers that follow one another: its .even and .odd are Floats */
typedef uchar16 BytePairs;
#define load_pairs(p) vload16(0, p)
#define load_half_pairs(p) load_halfs16(p)
/* The even and the odd numbers of two runs, the second of which follows the first. */
#define EVEN_OF(first, second) ((float8)((first).even, (second).even))
#define ODD_OF(first, second) ((float8)((first).odd, (second).odd))
/* The left and the right taps of LANES pixels in an image of half the size, from the first left one on. */
#define load_left_taps(p) (vload8(0, p).s01122334)
#define load_right_taps(p) (vload8(0, p).s12233445)
/* Numbers for LANES pixels of an image of twice the size, from column x on: each twice; of p and of q in turns. */
#define load_doubled(p) (vload4(0, p).s00112233)
#define load_in_turns(p, q, x) ((float8)(vload4(0, (p) + (x) / 2), vload4(0, (q) + (x) / 2)).s04152637)
#define LANE_NUMBERS ((int8)(0, 1, 2, 3, 4, 5, 6, 7))
#define ALL_LANES ((int8)(-1))
#define RUN 16
#define load_two_texels(i, image) load_halfs8((image) + 4 * (i))
#define load_four_texels(i, image) load_halfs16((image) + 4 * (i))
#define FIRST_LANE(v) ((v).s0)
#define LAST_LANE(v) ((v).s7)

/* p[i] of each lane. */
#define GATHER(p, i)                                                                                                   \
    ((p)[(i).s0], (p)[(i).s1], (p)[(i).s2], (p)[(i).s3], (p)[(i).s4], (p)[(i).s5], (p)[(i).s6], (p)[(i).s7])
#define gather_floats(p, i) ((float8)GATHER(p, i))
#define gather_bytes(p, i) ((uchar8)GATHER(p, i))

/* Whether any lane is -1: PoCL makes a test and a jump per lane of any(). */
INLINE bool any_of_lanes(const int8 condition) { return as_ulong(convert_char8(condition)) != 0; }
INLINE bool all_of_lanes(const int8 condition) { return as_ulong(convert_char8(condition)) == ~0UL; }

/* Halves of any place, copied: PoCL 3.1 takes those of vload_half8 for aligned ones, and converts 16 by parts of 4. */
INLINE float8 load_halfs8(__global const half *p) {
    const ushort8 bits = vload8(0, (__global const ushort *)p);
    return vload_half8(0, (const half *)&bits);
}

INLINE float16 load_halfs16(__global const half *p) { return (float16)(load_halfs8(p), load_halfs8(p + 8)); }

INLINE bool run_is_zero(__global const uchar *p) {
    const ulong2 bits = as_ulong2(vload16(0, p));
    return (bits.x | bits.y) == 0;
}

INLINE bool run_has(__global const uchar *p, const uchar value) {
    const ulong2 equal = as_ulong2(vload16(0, p) == (uchar16)(value));
    return (equal.x | equal.y) != 0;
}

INLINE Floats load_xy(__global const float2 *p, Floats *y) {
    const float16 xy = vload16(0, (__global const float *)p);
    *y = xy.odd;
    return xy.even;
}

/* The x and y of float2 that lie at i. */
INLINE Floats gather_xy(__global const float2 *p, const Ints i, Floats *y) {
    const float16 xy = (float16)GATHER(p, i);
    *y = xy.odd;
    return xy.even;
}

INLINE void store_xy(const Floats x, const Floats y, __global float2 *p) {
    vstore16((float16)(x.s0, y.s0, x.s1, y.s1, x.s2, y.s2, x.s3, y.s3, x.s4, y.s4, x.s5, y.s5, x.s6, y.s6, x.s7, y.s7),
             0, (__global float *)p);
}

#else

#define WIDE
#define LISTS __attribute__((reqd_work_group_size(16, 8, 1)))
typedef float Floats;
typedef int Ints;     /* of conditions: 1 or 0 */
typedef uint Uints;
typedef uchar Bytes;
#define ANY(condition) ((condition) != 0)
#define ALL(condition) ((condition) != 0)
#define ANY_BYTE(bytes) ((bytes) != 0)
#define load_floats(i, p) ((p)[i])
#define load_bytes(i, p) ((p)[i])
#define load_uints(i, p) ((p)[i])
#define store_floats(v, i, p) ((p)[i] = (v))
#define store_bytes(v, i, p) ((p)[i] = (v))
#define store_halfs(v, i, p) vstore_half_rte(v, i, p)
#define to_floats convert_float
#define to_ints convert_int
#define to_uints convert_uint
#define to_bytes convert_uchar
#define ints_as_floats as_float
#define floats_as_ints as_int
typedef float2 Pairs;
typedef uchar2 BytePairs;
#define load_pairs(p) vload2(0, p)
#define load_half_pairs(p) vload_half2(0, p)
#define EVEN_OF(first, second) (first)
#define ODD_OF(first, second) (second)
#define load_left_taps(p) ((p)[0])
#define load_right_taps(p) ((p)[1])
#define load_doubled(p) ((p)[0])
#define load_in_turns(p, q, x) (((x) & 1 ? q : p)[(x) / 2])
#define LANE_NUMBERS 0
#define ALL_LANES 1
#define RUN 1
#define FIRST_LANE(v) (v)
#define LAST_LANE(v) (v)
#define gather_floats(p, i) ((p)[i])
#define gather_bytes(p, i) ((p)[i])

INLINE bool run_is_zero(__global const uchar *p) { return *p == 0; }
INLINE bool run_has(__global const uchar *p, const uchar value) { return *p == value; }

INLINE float8 load_two_texels(const int i, __global const half *image) {
    return (float8)(load_texel(i, image), load_texel(i + 1, image));
}

INLINE float16 load_four_texels(const int i, __global const half *image) {
    return (float16)(load_two_texels(i, image), load_two_texels(i + 2, image));
}

INLINE Floats gather_xy(__global const float2 *p, const int i, Floats *y) {
    *y = p[i].y;
    return p[i].x;
}

INLINE Floats load_xy(__global const float2 *p, Floats *y) { return gather_xy(p, 0, y); }

INLINE void store_xy(const Floats x, const Floats y, __global float2 *p) { *p = (float2)(x, y); }

#endif

/* The number in lane k, for what is done lane by lane. */
INLINE float float_of(const Floats *v, const int k) { return ((const float *)v)[k]; }
INLINE int int_of(const Ints *v, const int k) { return ((const int *)v)[k]; }
INLINE uint uint_of(const Uints *v, const int k) { return ((const uint *)v)[k]; }
INLINE uchar byte_of(const Bytes *v, const int k) { return ((const uchar *)v)[k]; }
INLINE void set_float(Floats *v, const int k, const float number) { ((float *)v)[k] = number; }
INLINE void set_byte(Bytes *v, const int k, const uchar number) { ((uchar *)v)[k] = number; }

/* The lesser and the greater of finite numbers: comparisons are cheaper than fmin and fmax, which must sort out NaN.
   If one is NaN, `wide_lesser` gives the second and `wide_greater` the first. */
INLINE Floats wide_lesser(const Floats a, const Floats b) { return a < b ? a : b; }
INLINE Floats wide_greater(const Floats a, const Floats b) { return a < b ? b : a; }
INLINE Floats within_limits(const Floats x, const Floats least, const Floats most) {
    return wide_lesser(wide_greater(x, least), most);
}

/* Whether all lanes are among the `count` pixels that are left of a row, which are at least one. With one lane it is
   a constant: GPUs need no other path. */
#define IS_WHOLE(count) (LANES == 1 || (count) >= LANES)

/* The first `count` lanes, or all if it is more, for the last pixels of a row. Loads repeat the last of them. */
INLINE Floats load_some_floats(const int count, __global const float *p) {
    return IS_WHOLE(count) ? load_floats(0, p) : gather_floats(p, min((Ints)(LANE_NUMBERS), (Ints)(count - 1)));
}

INLINE Ints load_some_ints(const int count, __global const int *p) {
    return floats_as_ints(load_some_floats(count, (__global const float *)p));
}

INLINE Bytes load_some_bytes(const int count, __global const uchar *p) {
    return IS_WHOLE(count) ? load_bytes(0, p) : gather_bytes(p, min((Ints)(LANE_NUMBERS), (Ints)(count - 1)));
}

INLINE Floats load_some_xy(const int count, __global const float2 *p, Floats *y) {
    return IS_WHOLE(count) ? load_xy(p, y) : gather_xy(p, min((Ints)(LANE_NUMBERS), (Ints)(count - 1)), y);
}

INLINE void store_some_bytes(const Bytes v, const int count, __global uchar *p) {
    if (IS_WHOLE(count)) {
        store_bytes(v, 0, p);
        return;
    }
    for (int k = 0; k < count; ++k) p[k] = byte_of(&v, k);
}

INLINE void store_some_xy(const Floats x, const Floats y, const int count, __global float2 *p) {
    if (IS_WHOLE(count)) {
        store_xy(x, y, p);
        return;
    }
    for (int k = 0; k < count; ++k) p[k] = (float2)(float_of(&x, k), float_of(&y, k));
}

INLINE void store_some_floats(const Floats v, const int count, __global float *p) {
    if (IS_WHOLE(count)) {
        store_floats(v, 0, p);
        return;
    }
    for (int k = 0; k < count; ++k) p[k] = float_of(&v, k);
}

INLINE void store_some_halfs(const Floats v, const int count, __global half *p) {
    if (IS_WHOLE(count)) {
        store_halfs(v, 0, p);
        return;
    }
    for (int k = 0; k < count; ++k) vstore_half_rte(float_of(&v, k), k, p);
}

/* x + 0.5 of each lane's pixel. */
INLINE Floats row_centers(const int x) { return to_floats(LANE_NUMBERS) + ((float)x + 0.5f); }

/* The column and the row of pixel i of an image. */
INLINE void wide_column_and_row(const Ints i, const int width, Ints *column, Ints *row) {
    const Ints near = to_ints(to_floats(i) * (1.0f / (float)width)), rest = i - near * width; /* one row off at most */
    *row = near + (rest < 0 ? (Ints)(-1) : rest >= width ? (Ints)(1) : (Ints)(0));
    *column = i - *row * width;
}

/* View-space or pixel positions, lane by lane. */
typedef struct {
    Floats x, y, z;
} Wide3;

DEFINE_DIVIDE(Floats, wide_divide)
DEFINE_ROOT(Floats, wide_root)

/* unproject of common.h. */
INLINE Wide3 wide_unproject(const Floats px_x, const Floats px_y, const Floats z, const Pinhole inverse) {
    const Floats scale = isinf(z) ? (Floats)(1.0f) : z;
    const Wide3 v = {(px_x - inverse.z) * inverse.x * scale, (px_y - inverse.w) * inverse.y * scale, scale};
    return v;
}

/* reproject of common.h: `exactly`, with the same bits, or with plain divisions. */
INLINE Wide3 wide_reproject_so(const bool exactly, const Floats px_x, const Floats px_y, const Floats z,
                               const Reprojection r) {
    const Ints sky = isinf(z);
    const Wide3 v = wide_unproject(px_x, px_y, z, r.source_inverse);
    const Floats x = r.row0.x * v.x + r.row0.y * v.y + r.row0.z * v.z;
    const Floats y = r.row1.x * v.x + r.row1.y * v.y + r.row1.z * v.z;
    const Floats depth = r.row2.x * v.x + r.row2.y * v.y + r.row2.z * v.z;
    const Floats target_x = sky ? x : x + r.row0.w, target_y = sky ? y : y + r.row1.w,
                 target_z = sky ? depth : depth + r.row2.w;
    const Ints front = target_z > 0.0f;
    const Floats view_x = r.target.x * target_x, view_y = r.target.y * target_y;
    Wide3 out;
    out.x = front ? (exactly ? wide_divide(view_x, target_z) : view_x / target_z) + r.target.z : (Floats)(0.0f);
    out.y = front ? (exactly ? wide_divide(view_y, target_z) : view_y / target_z) + r.target.w : (Floats)(0.0f);
    out.z = front ? (sky ? (Floats)(INFINITY) : target_z) : (Floats)(-1.0f);
    return out;
}

INLINE Wide3 wide_reproject(const Floats px_x, const Floats px_y, const Floats z, const Reprojection r) {
    return wide_reproject_so(true, px_x, px_y, z, r);
}

/* Depth has the same bits as reproject's; pixel positions are off by less than ROUGHLY of the larger side of an
   image whose principal point it holds: two divisions of 2.5 ulp differ by 3.6e-7 of it at most, and their sums by
   1.2e-7 more. */
#define ROUGHLY 5e-7f
INLINE Wide3 wide_reproject_roughly(const Floats px_x, const Floats px_y, const Floats z, const Reprojection r) {
    return wide_reproject_so(false, px_x, px_y, z, r);
}
