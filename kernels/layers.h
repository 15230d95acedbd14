/* Layers of the rendered frame, at steps of depth whose two sides move apart: for soft silhouettes (silhouettes.cl),
   found beside splatting (warp.cl). */

#include "stencil.h"
#include "rgb9e5.h"
#include "color_code.h"

/* What set the thresholds: docs/deviations.md, "Silhouettes stay antialiased". */
#define STEP 0.02f           /* relative step of inverse depth between two layers */
#define MOVES_APART 0.5f     /* px: layers that deviate less are resampled together */
#define AT_EDGE 0.05f        /* weight of colors at edges, which may be mixed, too */

#define SHARES 255.0f         /* of a pixel, stored as a byte */

/* Values of `layer`: the pixel belongs to one of two layers around it that move apart. */
#define NO_LAYER 0
#define FAR 1
#define NEAR 2

#define ANYWHERE 100000000.0f /* px: fragments that go nowhere have targets beyond this */
/* MARKED: px around a layer's fragments within which silhouettes are looked for; less than a block's sides */
#define MARKED 3

/* Weight of pixel k of 3x3 in the middle one's coverage: a pixel's area, filtered over two. */
INLINE float tent(const int k) { return k == 4 ? 4.0f : (k & 1) ? 2.0f : 1.0f; }

/* The rendered frame, and where its fragments go. */
typedef struct {
    int width, height;
    float2 zoom;
    __global const float *target_position;
    __global const half *codes;
} Source;

INLINE Source source_of(__constant Frame *frame, __global const float *target_position, __global const half *codes) {
    const Source s = {frame->source_width, frame->source_height, frame->zoom, target_position, codes};
    return s;
}

/* Depths of the 3x3 pixels around each of them, 0 outside of the image, and the depth halfway between the sides if
   these are apart. */
typedef struct {
    Floats z[9], middle;
} Depths;

INLINE void load_depths(const Span p, __global const float *depth, Depths *d) {
#pragma unroll
    for (int k = 0; k < 9; ++k) d->z[k] = beside(p, depth, k % 3 - 1, k / 3 - 1);
}

/* Gives which of them lie at a step of depth. */
INLINE Ints at_step(Depths *d) {
    Floats nearest = INFINITY, farthest = 0.0f;
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const Floats z = d->z[k];
        nearest = ((z > 0.0f) & (z < nearest)) ? z : nearest;
        farthest = z > farthest ? z : farthest;
    }
    const Ints step = nearest < (1.0f - STEP) * farthest;
    if (ANY(step))
        d->middle = 2.0f * nearest * (isinf(farthest) ? (Floats)(1.0f) : wide_divide(farthest, nearest + farthest));
    return step;
}

/* Gives which of them have layers around, on both sides of d->middle, that move apart. */
INLINE Ints layers_part(const Span p, const Source s, __global const float *depth, Depths *d) {
    load_depths(p, depth, d);
    const Ints step = at_step(d);
    if (!ANY(step)) return step;
    __global const float *to_x = s.target_position, *to_y = to_x + p.width * p.height;
    const Floats x = beside(p, to_x, 0, 0), y = beside(p, to_y, 0, 0);
    const Ints is_near = d->z[4] < d->middle;
    Ints part = (Ints)(0);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1;
        if (k == 4) continue;
        const Floats ex = fabs(beside(p, to_x, dx, dy) - x - s.zoom.x * (float)dx);
        const Floats ey = fabs(beside(p, to_y, dx, dy) - y - s.zoom.y * (float)dy);
        part |= is_inside(p, dx, dy) & ((d->z[k] < d->middle) != is_near) & (d->z[k] > 0.0f) & (ex < ANYWHERE)
                & ((ex > MOVES_APART) | (ey > MOVES_APART));
    }
    return step & part & (d->z[4] > 0.0f);
}

/* Level 0 of the background: the rendered frame's static surfaces as they were before something covered them. */
typedef struct {
    bool exists;
    float code_offset;
    __global const uchar *state;
    __global const float *depth;
    __global const uint *color;
} Memory;

/* What is known of pixels' two layers: the near one's share, the code of the covered surface's color, the mean of the
   far layer's codes, and the squared contrast of both layers, times 1 / size. */
typedef struct {
    Floats share, behind[3], far[3], contrast, per_size;
} Unmixed;

/* Mixes the covered surface's color of the `wanted` pixels, of depth z, with what is remembered of it. The larger the
   near layer's share, the more that counts, if it is as likely as the far layer's mean color. */
INLINE void recall(const Span p, const Ints wanted, const Floats z, const Memory m, Unmixed *u) {
    const int count = min(LANES, p.width - p.x);
    for (int k = 0; m.exists && ANY(wanted) && k < count; ++k) {
        const int src = p.y * p.width + p.x + k;
        if (!int_of(&wanted, k) || m.state[src] != REMEMBERED) continue;
        const float own = float_of(&z, k), contrast = float_of(&u->contrast, k);
        if (!is_same_surface(m.depth[src], own, STEP * own) || !(contrast > 0.0f)) continue;
        const float3 remembered = encode_color(unpack_color(m.color[src]), m.code_offset);
        const float3 far = {float_of(u->far, k), float_of(u->far + 1, k), float_of(u->far + 2, k)},
                     behind = {float_of(u->behind, k), float_of(u->behind + 1, k), float_of(u->behind + 2, k)};
        const float differs = squared_length((remembered - far) * float_of(&u->per_size, k));
        const float counts = divide(2.0f * float_of(&u->share, k) * contrast, contrast + differs);
        const float3 mixed = behind + counts * (remembered - behind);
        set_float(u->behind, k, mixed.x);
        set_float(u->behind + 1, k, mixed.y);
        set_float(u->behind + 2, k, mixed.z);
    }
}

/* The nearer layer's share of pixels, and the color of the covered surface: where a pixel's color lies between the
   mean colors of both layers around. */
INLINE void unmix(const Span p, const Depths *d, __global const half *codes, __global const uchar *links, Unmixed *u) {
    Strip near_sum, far_sum;
#pragma unroll
    for (int part = 0; part < PARTS; ++part) near_sum.part[part] = far_sum.part[part] = (Texels)(0.0f);
#pragma unroll
    for (int k = 0; k < 9; ++k) {
        const int dx = k % 3 - 1, dy = k / 3 - 1;
        const Ints is_near = d->z[k] < d->middle;
        const Floats weight = (d->z[k] > 0.0f) & is_inside(p, dx, dy) ? (Floats)(tent(k)) : (Floats)(0.0f);
        const Floats certain = bytes_beside(p, links, dx, dy) == ALL_LINKS ? weight : AT_EDGE * weight;
        const Floats near_weight = is_near ? certain : (Floats)(0.0f), far_weight = is_near ? (Floats)(0.0f) : certain;
        Strip c;
        colors_beside(p, codes, dx, dy, &c);
#pragma unroll
        for (int part = 0; part < PARTS; ++part) {
            near_sum.part[part] += OF_TEXELS(near_weight, part) * c.part[part];
            far_sum.part[part] += OF_TEXELS(far_weight, part) * c.part[part];
        }
    }
    const Ints is_near = d->z[4] < d->middle;
    Strip middle;
    colors_beside(p, codes, 0, 0, &middle);
    const Wide4 own = channels_of(&middle);
    Wide4 near = channels_of(&near_sum), far = channels_of(&far_sum);
    const Floats per_near = wide_divide((Floats)(1.0f), near.c[3]), per_far = wide_divide((Floats)(1.0f), far.c[3]);
    Floats size = 0.0f, squared = 0.0f, along = 0.0f;
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        near.c[c] *= per_near;
        far.c[c] *= per_far;
        size = fmax(size, fmax(near.c[c], far.c[c]));
    }
    const Floats scale = wide_divide((Floats)(1.0f), 1e-4f + size);
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        const Floats relative = (near.c[c] - far.c[c]) * scale;
        squared += relative * relative;
        along += (own.c[c] - far.c[c]) * scale * relative;
    }
    const Floats low = is_near ? (Floats)(0.5f) : (Floats)(0.0f);
    const Floats coverage = squared > 0.0f ? clamp(wide_divide(along, squared), low, low + 0.5f) : (Floats)(0.5f);
#pragma unroll
    for (int c = 0; c < 3; ++c) {
        u->far[c] = far.c[c];
        u->behind[c] = is_near ? far.c[c] : own.c[c] - coverage * (near.c[c] - far.c[c]);
    }
    u->share = coverage;
    u->contrast = squared;
    u->per_size = scale;
}

/* Marks the blocks around the pixel where a fragment goes. */
INLINE void mark_around(const float2 px, const int width, const int height, __global uchar *marked) {
    if (!(px.x > -(float)MARKED && px.y > -(float)MARKED && px.x < (float)(width + MARKED)
          && px.y < (float)(height + MARKED)))
        return;
    for (int k = 0; k < 4; ++k) {
        const int x = (int)px.x + ((k & 1) ? MARKED : -MARKED), y = (int)px.y + ((k >> 1) ? MARKED : -MARKED);
        marked[block_of(clamp(x, 0, width - 1), clamp(y, 0, height - 1), width)] = 1;
    }
}

/* Where the layers of the rendered frame are stored, and where silhouettes are looked for. */
typedef struct {
    __global uchar *layer;
    __global uint *behind;
    __global uchar *share, *marked;
} FoundLayers;

/* Finds which layer LANES pixels belong to, outside of smooth blocks, in which nothing moves apart; where it does, the
   color of the far layer, `behind`, and the near one's `share` of the pixel. Marks the target blocks where they go;
   they come unmarked. */
INLINE void find_layers(const int src_x, const int src_y, __constant Frame *frame, __global const float *depth,
                        __global const uchar *links, __global const uchar *smooth,
                        __global const float *target_position, __global const half *codes, const Memory memory,
                        const FoundLayers to) {
    const int source_width = frame->source_width, source_height = frame->source_height;
    const int target_width = frame->target_width, target_height = frame->target_height;
    const int src = src_y * source_width + src_x, count = min(source_width - src_x, LANES);
    if (smooth[block_of(src_x, src_y, source_width)]) {
        store_some_bytes((Bytes)(NO_LAYER), count, to.layer + src);
        return;
    }
    const Source s = source_of(frame, target_position, codes);
    Span p = span_at(src_x, src_y, source_width, source_height);
    Depths d;
    Ints part = to_ints(load_some_bytes(count, links + src)) != ALL_LINKS;
    Unmixed u;
    if (ANY(part)) {
        if (p.inner) {
            p.inner = true;
            part &= layers_part(p, s, depth, &d);
            if (ANY(part)) unmix(p, &d, codes, links, &u);
        } else {
            part &= layers_part(p, s, depth, &d);
            if (ANY(part)) unmix(p, &d, codes, links, &u);
        }
    }
    if (!ANY(part)) {
        store_some_bytes((Bytes)(NO_LAYER), count, to.layer + src);
        return;
    }
    const Ints side = d.z[4] < d.middle ? (Ints)(NEAR) : (Ints)(FAR);
    store_some_bytes(to_bytes(part ? side : (Ints)(NO_LAYER)), count, to.layer + src);
    recall(p, part & !(d.z[4] < d.middle), d.z[4], memory, &u);
    const Ints packed = pack_colors(u.behind[0], u.behind[1], u.behind[2]), bytes = to_ints(SHARES * u.share + 0.5f);
    for (int k = 0; k < count; ++k) {
        if (!int_of(&part, k)) continue;
        to.behind[src + k] = (uint)int_of(&packed, k);
        to.share[src + k] = (uchar)int_of(&bytes, k);
        mark_around(position_of(target_position, src + k, source_width * source_height).xy, target_width, target_height,
                    to.marked);
    }
}
