/* Geometry of the built-in scenes: records, primitives, traversal.

   Space: "rel" is the world with its origin at the camera; "local" is an object's own rigid frame, in which its
   primitives and textures are given. */

#define SHADED_TILE 16
#define BOX 0
#define ELLIPSOID 1
#define CAPSULE 2
#define CONE 3
#define MAX_BOUNCES 3
#define CASTS_SHADOW 1

/* Records, in float4. */
#define OBJECT_SIZE 7    /* bound (center rel, radius); rel -> local rows; rel -> other view rows */
/* MATERIAL_SIZE: color, texture; color2, scale; f0, roughness, mirror, transparency; emission, contrast; seed */
#define MATERIAL_SIZE 5
#define LIGHT_SIZE 3     /* position or direction rel, size; color, kind; axis, cos of the cone */
#define SUN 0
#define LAMP 1
#define SPOT 2
#define FILL 3

/* Rows of the `frame` buffer. */
#define VIEW_TO_REL 0
#define PINHOLE_INVERSE 3
#define OTHER_PINHOLE 4
#define REL_TO_OTHER 5
#define AMBIENT_UP 8
#define AMBIENT_DOWN 9
#define ZENITH 10        /* rgb, cloud cover */
#define HORIZON 11       /* rgb, cloud seed */
#define SUN_DISC 12      /* direction rel, cos of its angular radius */
#define SUN_COLOR 13
#define HAZE 14          /* rgb, density per meter */

typedef struct {
    __global const float4 *frame;
    __global const float4 *objects;
    __global const int4 *object_info;  /* first primitive, count, flags, 0 */
    __global const float4 *prims;      /* a, b per primitive */
    __global const int2 *prim_info;    /* type, material */
    __global const float4 *materials;
    __global const float4 *lights;
    __global const float4 *nodes;      /* two per node */
    __global const int *leaf_of;       /* node of each object */
    int node_count, light_count;
} World;

typedef struct {
    float t;
    int object, prim;
} Hit;

/* By the rows of a rigid 3x4. */
INLINE float3 turn(__global const float4 *rows, const float3 v) {
    return (float3)(dot(rows[0].xyz, v), dot(rows[1].xyz, v), dot(rows[2].xyz, v));
}

INLINE float3 move(__global const float4 *rows, const float3 v) {
    return turn(rows, v) + (float3)(rows[0].w, rows[1].w, rows[2].w);
}

INLINE float3 nonzero(const float3 d) { return fabs(d) < 1e-18f ? (float3)(1e-18f) : d; }

/* ---- primitives: intersection and signed distance, all in local space ---- */

INLINE float lesser(const float a, const float b) { return a < b ? a : b; }
INLINE float greater(const float a, const float b) { return a > b ? a : b; }

/* Parameters at which a ray enters and leaves the box center +- half. `inverse` is 1 / direction. */
INLINE float2 box_span(const float3 center, const float3 half_size, const float3 o, const float3 inverse) {
    const float mx = (center.x - o.x) * inverse.x, rx = half_size.x * fabs(inverse.x);
    const float my = (center.y - o.y) * inverse.y, ry = half_size.y * fabs(inverse.y);
    const float mz = (center.z - o.z) * inverse.z, rz = half_size.z * fabs(inverse.z);
    return (float2)(greater(greater(mx - rx, my - ry), mz - rz), lesser(lesser(mx + rx, my + ry), mz + rz));
}

INLINE float hit_box(const float4 a, const float4 b, const float3 o, const float3 d) {
    const float2 span = box_span(a.xyz, b.xyz, o, 1.0f / nonzero(d));
    return span.x < span.y ? span.x : -INFINITY;
}

INLINE float hit_ellipsoid(const float4 a, const float4 b, const float3 o, const float3 d) {
    const float3 p = (o - a.xyz) / b.xyz, v = d / b.xyz;
    const float vv = dot(v, v);
    const float closest = -dot(p, v) / vv;
    const float3 q = p + closest * v;
    const float h = 1.0f - dot(q, q);
    return h > 0.0f ? closest - sqrt(h / vv) : -INFINITY;
}

INLINE float hit_capsule(const float4 a, const float4 b, const float3 o, const float3 d) {
    const float3 ba = b.xyz - a.xyz, oa = o - a.xyz;
    const float baba = dot(ba, ba), bad = dot(ba, d), baoa = dot(ba, oa), dd = dot(d, d);
    const float3 dp = d - ba * (bad / baba), op = oa - ba * (baoa / baba);  /* perpendicular to the axis */
    const float k2 = greater(dot(dp, dp), 1e-12f * dd), k1 = dot(dp, op);
    const float3 q = op - dp * (k1 / k2);
    const float h = a.w * a.w - dot(q, q);
    if (h < 0.0f) return -INFINITY;
    const float t = -k1 / k2 - sqrt(h / k2);
    const float y = baoa + t * bad;
    if (y > 0.0f && y < baba) return t;
    const float3 oc = y <= 0.0f ? oa : o - b.xyz;
    const float closest = -dot(oc, d) / dd;
    const float3 c = oc + closest * d;
    const float hc = a.w * a.w - dot(c, c);
    return hc > 0.0f ? closest - sqrt(hc / dd) : -INFINITY;
}

INLINE float hit_cone(const float4 a, const float4 b, const float3 o, const float3 d) {
    const float3 ba = b.xyz - a.xyz, oa = o - a.xyz;
    const float m0 = dot(ba, ba), m1 = dot(oa, ba), m2 = dot(d, ba);
    const float slope = (a.w - b.w) / m0;
    /* Caps: the one that faces the ray. */
    const bool top = m2 < 0.0f;
    const float cap = ((top ? m0 : 0.0f) - m1) / (fabs(m2) < 1e-18f ? 1e-18f : m2);
    const float3 pc = oa + cap * d - (top ? ba : (float3)(0.0f));
    const float rc = top ? b.w : a.w;
    if (fabs(m2) > 1e-12f && dot(pc, pc) < rc * rc) return cap;
    /* Side: |p perpendicular|^2 = (ra - slope y)^2. */
    const float3 op = oa - ba * (m1 / m0), dp = d - ba * (m2 / m0);
    const float r0 = a.w - slope * m1, r1 = -slope * m2;
    const float k2 = dot(dp, dp) - r1 * r1, k1 = dot(dp, op) - r0 * r1, k0 = dot(op, op) - r0 * r0;
    const float h = k1 * k1 - k2 * k0;
    if (h < 0.0f || fabs(k2) < 1e-18f) return -INFINITY;
    const float t = (-k1 - sqrt(h)) / k2;
    const float y = m1 + t * m2;
    return y > 0.0f && y < m0 ? t : -INFINITY;
}

INLINE float hit_prim(const int type, const float4 a, const float4 b, const float3 o, const float3 d) {
    if (type == BOX) return hit_box(a, b, o, d);
    if (type == ELLIPSOID) return hit_ellipsoid(a, b, o, d);
    if (type == CAPSULE) return hit_capsule(a, b, o, d);
    return hit_cone(a, b, o, d);
}

INLINE float3 prim_normal(const int type, const float4 a, const float4 b, const float3 p) {
    if (type == BOX) {
        const float3 q = p - a.xyz;
        const float3 gap = fabs(fabs(q) - b.xyz);
        if (gap.x <= gap.y && gap.x <= gap.z) return (float3)(copysign(1.0f, q.x), 0.0f, 0.0f);
        if (gap.y <= gap.z) return (float3)(0.0f, copysign(1.0f, q.y), 0.0f);
        return (float3)(0.0f, 0.0f, copysign(1.0f, q.z));
    }
    if (type == ELLIPSOID) return normalize((p - a.xyz) / (b.xyz * b.xyz));
    const float3 ba = b.xyz - a.xyz, pa = p - a.xyz;
    const float baba = dot(ba, ba), h = dot(pa, ba) / baba;
    if (type == CAPSULE) return normalize(pa - ba * clamp(h, 0.0f, 1.0f));
    const float3 radial = pa - ba * h;
    const float r = length(radial), length_ba = sqrt(baba);
    const float side = fabs(r - mix(a.w, b.w, h));
    const float3 axis = ba / length_ba;
    if (h * length_ba < side && h < 0.5f) return -axis;
    if ((1.0f - h) * length_ba < side && h > 0.5f) return axis;
    return normalize(radial / greater(r, 1e-9f) * length_ba + axis * (a.w - b.w));
}

INLINE float distance_to(const int type, const float4 a, const float4 b, const float3 p) {
    if (type == BOX) {
        const float x = fabs(p.x - a.x) - b.x, y = fabs(p.y - a.y) - b.y, z = fabs(p.z - a.z) - b.z;
        const float out_x = greater(x, 0.0f), out_y = greater(y, 0.0f), out_z = greater(z, 0.0f);
        return sqrt(out_x * out_x + out_y * out_y + out_z * out_z) + lesser(greater(x, greater(y, z)), 0.0f);
    }
    if (type == ELLIPSOID) {
        const float3 q = (p - a.xyz) / b.xyz;
        const float k0 = length(q), k1 = length(q / b.xyz);
        return k0 < 1e-4f ? -lesser(b.x, lesser(b.y, b.z)) : k0 * (k0 - 1.0f) / k1;
    }
    const float3 ba = b.xyz - a.xyz, pa = p - a.xyz;
    const float baba = dot(ba, ba), h = dot(pa, ba) / baba;
    if (type == CAPSULE) return length(pa - ba * clamp(h, 0.0f, 1.0f)) - a.w;
    const float x = length(pa - ba * h), drop = b.w - a.w;
    const float cap_x = greater(0.0f, x - (h < 0.5f ? a.w : b.w)), cap_y = fabs(h - 0.5f) - 0.5f;
    const float f = clamp((drop * (x - a.w) + h * baba) / (drop * drop + baba), 0.0f, 1.0f);
    const float side_x = x - a.w - f * drop, side_y = h - f;
    const float inside_sign = side_x < 0.0f && cap_y < 0.0f ? -1.0f : 1.0f;
    return inside_sign * sqrt(lesser(cap_x * cap_x + cap_y * cap_y * baba, side_x * side_x + side_y * side_y * baba));
}

/* Parameter at which the ray comes closest to the primitive (exact for spheres and capsules). */
INLINE float closest_approach(const int type, const float4 a, const float4 b, const float3 o, const float3 d) {
    if (type == BOX) {
        const float2 span = box_span(a.xyz, b.xyz, o, 1.0f / nonzero(d));
        return span.y < 0.0f ? -1.0f : 0.5f * (greater(span.x, 0.0f) + span.y);
    }
    if (type == ELLIPSOID) {
        const float3 p = (o - a.xyz) / b.xyz, v = d / b.xyz;
        return -dot(p, v) / dot(v, v);
    }
    const float3 ba = b.xyz - a.xyz, oa = o - a.xyz;
    const float baba = dot(ba, ba), bad = dot(ba, d), baoa = dot(ba, oa), dd = dot(d, d), doa = dot(d, oa);
    const float across = greater(baba * dd - bad * bad, 1e-9f);
    const float h = clamp((baoa * dd - bad * doa) / across, 0.0f, 1.0f);
    return (h * bad - doa) / dd;
}

/* ---- traversal: `nodes` is a tree of boxes in depth-first order, (min, next node if missed), (max, object or -1)
   ---- */

/* Whether a ray with 0 <= t <= t_max meets the box low .. high. */
INLINE bool meets_box(const float3 low, const float3 high, const float3 o, const float3 inverse, const float t_max) {
    const float ax = (low.x - o.x) * inverse.x, bx = (high.x - o.x) * inverse.x;
    const float ay = (low.y - o.y) * inverse.y, by = (high.y - o.y) * inverse.y;
    const float az = (low.z - o.z) * inverse.z, bz = (high.z - o.z) * inverse.z;
    const float enter = greater(greater(lesser(ax, bx), lesser(ay, by)), greater(lesser(az, bz), 0.0f));
    const float leave = lesser(lesser(greater(ax, bx), greater(ay, by)), lesser(greater(az, bz), t_max));
    return enter <= leave;
}

/* Nearest hit among the primitives of object i. */
INLINE Hit meet_object(const World w, const int i, const float3 o, const float3 d, const int skip, const Hit so_far) {
    Hit best = so_far;
    __global const float4 *object = w.objects + i * OBJECT_SIZE;
    const float4 bound = object[0];
    /* Small objects are met from nearby: their quadratics would cancel from afar. */
    const float dd = dot(d, d);
    const float start = bound.w < 8.0f ? greater((dot(bound.xyz - o, d) - bound.w * sqrt(dd)) / dd, 0.0f) : 0.0f;
    const float3 o_local = move(object + 1, o + start * d);
    const float3 d_local = turn(object + 1, d);
    const int4 info = w.object_info[i];
    for (int j = info.x; j < info.x + info.y; ++j) {
        if (j == skip) continue;
        const float t = start + hit_prim(w.prim_info[j].x, w.prims[2 * j], w.prims[2 * j + 1], o_local, d_local);
        if (t > 1e-4f && t < best.t) {
            best.t = t;
            best.object = i;
            best.prim = j;
        }
    }
    return best;
}

/* Nearest hit along o + t d. A primary ray looks through its tile's `list` of objects, others (list 0) through the
   tree. */
INLINE Hit trace(const World w, const float3 o, const float3 d, __global const int *list, const int skip) {
    Hit best = {INFINITY, -1, -1};
    const float3 inverse = 1.0f / nonzero(d);
    if (list) {
        for (int k = 1; k <= list[0]; ++k) {
            const int node = w.leaf_of[list[k]];
            if (meets_box(w.nodes[2 * node].xyz, w.nodes[2 * node + 1].xyz, o, inverse, best.t)) {
                best = meet_object(w, list[k], o, d, skip, best);
            }
        }
        return best;
    }
    int node = 0;
    while (node < w.node_count) {
        const float4 low = w.nodes[2 * node], high = w.nodes[2 * node + 1];
        const int object = as_int(high.w);
        if (!meets_box(low.xyz, high.xyz, o, inverse, best.t)) {
            node = as_int(low.w);
            continue;
        }
        ++node;
        if (object >= 0) best = meet_object(w, object, o, d, skip, best);
    }
    return best;
}

/* Visibility in [0, 1] of a light of angular radius `spread` (tangent) in direction d (unit) up to `t_max`. */
INLINE float visibility(const World w, const float3 o, const float3 d, const float t_max, const float spread,
                        const float footprint, const int skip) {
    float least = 1.0f;
    const float3 inverse = 1.0f / nonzero(d);
    int node = 0;
    while (node < w.node_count && least > -1.0f) {
        const float4 low = w.nodes[2 * node], high = w.nodes[2 * node + 1];
        const int i = as_int(high.w);
        const float3 size = high.xyz - low.xyz;
        const float ahead = greater(dot(0.5f * (low.xyz + high.xyz) - o, d), 0.0f) + 0.5f * (size.x + size.y + size.z);
        const float3 grown = (float3)(spread * lesser(ahead, t_max) + footprint);
        if (!meets_box(low.xyz - grown, high.xyz + grown, o, inverse, t_max)) {
            node = as_int(low.w);
            continue;
        }
        ++node;
        if (i < 0) continue;
        const int4 info = w.object_info[i];
        if (!(info.z & CASTS_SHADOW)) continue;
        __global const float4 *object = w.objects + i * OBJECT_SIZE;
        const float3 o_local = move(object + 1, o);
        const float3 d_local = turn(object + 1, d);
        for (int j = info.x; j < info.x + info.y; ++j) {
            if (j == skip) continue;
            const int type = w.prim_info[j].x;
            const float4 a = w.prims[2 * j], b = w.prims[2 * j + 1];
            const float t = closest_approach(type, a, b, o_local, d_local);
            if (t <= 0.0f || t >= t_max) continue;
            const float gap = distance_to(type, a, b, o_local + t * d_local);
            least = lesser(least, gap / (t * spread + footprint));
        }
    }
    const float x = clamp(0.5f + 0.5f * least, 0.0f, 1.0f);
    return x * x * (3.0f - 2.0f * x);
}

/* Openness in [0, 1] of the half space above a surface point, from distances at two heights. */
INLINE float openness(const World w, const float3 p, const float3 n, const int skip) {
    const float low_height = 0.12f, high_height = 0.7f;
    float near = low_height, far = high_height;
    const float3 p_high = p + high_height * n;
    int node = 0;
    while (node < w.node_count) {
        const float4 low = w.nodes[2 * node], high = w.nodes[2 * node + 1];
        const int i = as_int(high.w);
        const float gap_x = greater(greater(low.x - p_high.x, p_high.x - high.x), 0.0f);
        const float gap_y = greater(greater(low.y - p_high.y, p_high.y - high.y), 0.0f);
        const float gap_z = greater(greater(low.z - p_high.z, p_high.z - high.z), 0.0f);
        if (gap_x * gap_x + gap_y * gap_y + gap_z * gap_z > far * far) {
            node = as_int(low.w);
            continue;
        }
        ++node;
        if (i < 0) continue;
        const int4 info = w.object_info[i];
        __global const float4 *object = w.objects + i * OBJECT_SIZE;
        const float3 p_local = move(object + 1, p);
        const float3 n_local = turn(object + 1, n);
        for (int j = info.x; j < info.x + info.y; ++j) {
            if (j == skip) continue;
            const int type = w.prim_info[j].x;
            const float4 a = w.prims[2 * j], b = w.prims[2 * j + 1];
            near = lesser(near, distance_to(type, a, b, p_local + low_height * n_local));
            far = lesser(far, greater(distance_to(type, a, b, p_local + high_height * n_local), 0.0f));
        }
    }
    return clamp(near / low_height, 0.0f, 1.0f) * 0.45f + clamp(far / high_height, 0.0f, 1.0f) * 0.55f;
}
