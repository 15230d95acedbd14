/* Ray tracer of the built-in scenes: exact depth, motion and positions at pixel centers, antialiased color.

   Space: "rel" is the world with its origin at the camera; "local" is an object's own rigid frame, in which its
   primitives and textures are given. An unnormalized primary direction has view z = 1, so that its t is planar depth.
   Nothing here is random: soft shadows are closest-approach estimates, glossiness is a fan of directions. */

#include "../common.h"
#include "geometry.h"
#include "textures.h"

/* ---- shading ---- */

INLINE float3 sky_color(const World w, const float3 d, const float fp) {
    __global const float4 *frame = w.frame;
    const float up = clamp(d.y, 0.0f, 1.0f);
    float3 c = mix(frame[HORIZON].xyz, frame[ZENITH].xyz, pow(up, 0.55f));
    const float3 sun = frame[SUN_DISC].xyz;
    const float toward = clamp(dot(d, sun), 0.0f, 1.0f);
    c += frame[SUN_COLOR].xyz * (0.04f * pow(toward, 12.0f) + 0.12f * pow(toward, 180.0f));
    if (d.y > 0.02f) {
        const float2 plane = d.xz / (d.y + 0.12f);
        const float n = fbm((float3)(plane.x * 1.3f, frame[HORIZON].w, plane.y * 1.3f), fp * 1.5f / (d.y + 0.12f), 5);
        const float cover = smoothstep(0.62f - 0.5f * frame[ZENITH].w, 0.85f - 0.5f * frame[ZENITH].w, n)
                            * smoothstep(0.02f, 0.2f, d.y);
        const float3 cloud = frame[HORIZON].xyz * 0.5f + frame[SUN_COLOR].xyz * (0.10f + 0.05f * toward) * (1.5f - n);
        c = mix(c, cloud, 0.85f * cover);
    }
    const float edge = max(fp, 2e-4f);
    return c + frame[SUN_COLOR].xyz * 2.5f * smoothstep(-edge, edge, acos(frame[SUN_DISC].w) - acos(toward));
}

/* Radiance of the surface itself, without reflections and transmission. Lamps that add little, given the `weight` of
   the surface in the pixel, are taken as partly hidden. */
INLINE float3 surface_color(const World w, const int material_index, const float3 p, const float3 n, const float3 eye,
                            const float3 p_local, const float3 n_local, const float fp, const int prim,
                            const float weight) {
    __global const float4 *material = w.materials + material_index * MATERIAL_SIZE;
    const int type = w.prim_info[prim].x;
    const float4 prim_a = w.prims[2 * prim], prim_b = w.prims[2 * prim + 1];
    const bool solid = type == BOX || type == ELLIPSOID;
    const float3 center = solid ? prim_a.xyz : 0.5f * (prim_a.xyz + prim_b.xyz);
    const float3 extent = solid ? prim_b.xyz : (float3)(prim_a.w, 0.5f * length(prim_b.xyz - prim_a.xyz), prim_a.w);
    const float4 finish = material[2], glow = material[3];
    const float3 albedo = texture_color(material, p_local, n_local, center, extent, fp);
    const float open = openness(w, p, n, prim);
    const float3 ambient =
        mix(w.frame[AMBIENT_DOWN].xyz, w.frame[AMBIENT_UP].xyz, 0.5f + 0.5f * n.y) * (0.25f + 0.75f * open);
    float3 diffuse = ambient, highlight = (float3)(0.0f);
    const float power = 2.0f / max(finish.y * finish.y * finish.y, 1e-3f);
    for (int k = 0; k < w.light_count; ++k) {
        const float4 place = w.lights[k * LIGHT_SIZE], color = w.lights[k * LIGHT_SIZE + 1];
        const float4 cone = w.lights[k * LIGHT_SIZE + 2];
        const int kind = (int)color.w;
        const float3 to_light = kind == SUN ? place.xyz : place.xyz - p;
        const float range = length(to_light);
        const float3 l = to_light / range;
        float strength = kind == SUN ? 1.0f : 1.0f / (range * range + place.w * place.w);
        if (kind == SPOT) strength *= smoothstep(cone.w, mix(cone.w, 1.0f, 0.35f), -dot(l, cone.xyz));
        const float facing = dot(n, l);
        if (kind == FILL) {
            diffuse += color.xyz * strength * (0.5f + 0.5f * facing) * open;
            continue;
        }
        if (facing <= 0.0f || strength * max(color.x, max(color.y, color.z)) < 6e-3f) continue;
        const float brightest = max(color.x, max(color.y, color.z)) * strength * facing;
        const float so_far = max(diffuse.x, max(diffuse.y, diffuse.z));
        if (kind == SUN || brightest * weight > 0.05f * so_far) {
            strength *= visibility(w, p + n * 1e-3f, l, kind == SUN ? 1e4f : range - 1.2f * place.w,
                                   kind == SUN ? place.w : place.w / range, max(fp, 2e-3f), prim);
        } else {
            strength *= 0.7f;
        }
        diffuse += color.xyz * (strength * facing);
        const float3 middle = normalize(l - eye);
        highlight += color.xyz * (strength * facing * (power + 8.0f) * 0.04f * pow(max(dot(n, middle), 0.0f), power));
    }
    const float3 emitted = glow.xyz * (0.4f + 0.6f * albedo / max(material[0].xyz, 0.02f));
    return albedo * diffuse * (1.0f - finish.w) + highlight * finish.x + emitted;
}

INLINE float3 primary_direction(__global const float4 *frame, const float2 px) {
    const float4 inverse = frame[PINHOLE_INVERSE];
    const float3 v = (float3)((px.x - inverse.z) * inverse.x, (px.y - inverse.w) * inverse.y, 1.0f);
    return turn(frame + VIEW_TO_REL, v);
}

INLINE int surface_key(const World w, const Hit hit, const float3 o, const float3 d) {
    if (hit.prim < 0) return -1;
    __global const float4 *object = w.objects + hit.object * OBJECT_SIZE;
    int face = 0;
    if (w.prim_info[hit.prim].x == BOX) {
        const float3 p = move(object + 1, o + hit.t * d);
        const float3 n = prim_normal(BOX, w.prims[2 * hit.prim], w.prims[2 * hit.prim + 1], p);
        face = n.x > 0.5f ? 1 : n.x < -0.5f ? 2 : n.y > 0.5f ? 3 : n.y < -0.5f ? 4 : n.z > 0.5f ? 5 : 6;
    }
    return hit.prim * 8 + face;
}

#define WORLD_ARGUMENTS                                                                                                \
    __global const float4 *frame, __global const float4 *objects, __global const int4 *object_info,                    \
        __global const float4 *prims, __global const int2 *prim_info, __global const float4 *materials,                \
        __global const float4 *lights, __global const float4 *nodes, __global const int *leaf_of,                      \
        const int node_count, const int light_count, __global const int *tiles, const int tile_stride,                 \
        const int width, const int height
#define WORLD                                                                                                          \
    {frame, objects, object_info, prims, prim_info, materials, lights, nodes, leaf_of, node_count, light_count}

/* The objects that may be seen in the tile of pixel (x, y). */
INLINE __global const int *tile_of(__global const int *tiles, const int tile_stride, const int x, const int y,
                                   const int width) {
    return tiles + (y / SHADED_TILE * ((width + SHADED_TILE - 1) / SHADED_TILE) + x / SHADED_TILE) * tile_stride;
}

/* Objects that may be seen in each tile of SHADED_TILE x SHADED_TILE pixels, in the given order. One work item per
   tile; tiles: (count, objects ...) per tile, `tile_stride` wide. */
__kernel void bin(__global const float4 *frame, __global const float4 *objects, __global const int *order,
                  const int object_count, __global int *tiles, const int tile_stride, const int width,
                  const int height) {
    const int columns = (width + SHADED_TILE - 1) / SHADED_TILE, rows = (height + SHADED_TILE - 1) / SHADED_TILE;
    const int i = get_global_id(0);
    if (i >= columns * rows) return;
    const float x0 = (float)(i % columns * SHADED_TILE), y0 = (float)(i / columns * SHADED_TILE);
    const float x1 = x0 + SHADED_TILE, y1 = y0 + SHADED_TILE;
    const float3 c00 = primary_direction(frame, (float2)(x0, y0)), c10 = primary_direction(frame, (float2)(x1, y0));
    const float3 c01 = primary_direction(frame, (float2)(x0, y1)), c11 = primary_direction(frame, (float2)(x1, y1));
    const float3 forward = primary_direction(frame, (float2)(0.5f * (x0 + x1), 0.5f * (y0 + y1)));
    float3 side[4] = {cross(c00, c01), cross(c01, c11), cross(c11, c10), cross(c10, c00)};
    for (int k = 0; k < 4; ++k) side[k] = normalize(dot(side[k], forward) < 0.0f ? -side[k] : side[k]);
    __global int *list = tiles + i * tile_stride;
    int n = 0;
    for (int k = 0; k < object_count; ++k) {
        const float4 bound = objects[order[k] * OBJECT_SIZE];
        const float grown = -1.001f * bound.w - 1e-4f;
        bool seen = true;
        for (int s = 0; s < 4; ++s) seen = seen && dot(side[s], bound.xyz) > grown;
        if (seen) list[++n] = order[k];
    }
    list[0] = n;
}

/* Renders what each pixel's center sees. depth: view z, +inf for sky; motion: pixels, to the other camera at the other
   time; position: (x, y, z, 1) in the other view space, for sky (x/z, y/z, +inf, z) of the direction there; object_id:
   -1 for sky; keys: surface, for the antialiasing. */
__kernel void surfaces(WORLD_ARGUMENTS, __global float *depth, __global float2 *motion, __global float4 *position,
                       __global int *object_id, __global int *keys) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height) return;
    const World w = WORLD;
    const int i = y * width + x;
    const float2 px = pixel_center(x, y);
    const float3 d = primary_direction(frame, px);
    const Hit hit = trace(w, (float3)(0.0f), d, tile_of(tiles, tile_stride, x, y, width), -1);
    const bool sky = hit.prim < 0;
    const float3 other = sky ? turn(frame + REL_TO_OTHER, d) : move(objects + hit.object * OBJECT_SIZE + 4, hit.t * d);
    depth[i] = hit.t;
    object_id[i] = hit.object;
    keys[i] = surface_key(w, hit, (float3)(0.0f), d);
    motion[i] = other.z > 0.0f ? project(other, frame[OTHER_PINHOLE]) - px : (float2)(NAN);
    position[i] = sky ? (float4)(other.x / other.z, other.y / other.z, INFINITY, other.z) : (float4)(other, 1.0f);
}

/* Antialiased color: `base` samples where the surroundings are one surface, `samples` elsewhere; a surface is shaded
   once per pixel and its reflections once per sample. Textures are filtered over `footprint` pixels. Frames that are
   gathered over time have a `phase` each, so that few samples do not show the same part of a rough reflection in
   all. */
__kernel __attribute__((vec_type_hint(float4))) /* scalar code: Intel's vectorizer makes this kernel 20 times slower */
void shade(WORLD_ARGUMENTS, __global const float *depth, __global const int *object_id, __global const int *keys,
           const int base, const int samples, const int phase, const float footprint, __global half *color) {
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height) return;
    const World w = WORLD;
    const int i = y * width + x;
    const float pixel_angle = footprint * frame[PINHOLE_INVERSE].y;

    bool edge = false;
    for (int k = 0; k < 9; ++k) {
        const int near_x = clamp(x + k % 3 - 1, 0, width - 1), near_y = clamp(y + k / 3 - 1, 0, height - 1);
        edge = edge || keys[near_y * width + near_x] != keys[i];
    }
    int count = edge ? samples : base;
    int known_key[3] = {-2, -2, -2};
    float3 known_color[3];
    int oldest = 0;
    float3 sum = (float3)(0.0f);
    for (int s = 0; s < count; ++s) {
        /* The R2 sequence, from the center of the pixel. */
        const float jx = 0.5f + 0.75487767f * (float)s, jy = 0.5f + 0.56984029f * (float)s;
        const float2 px = (float2)((float)x + jx - floor(jx), (float)y + jy - floor(jy));
        float3 o = (float3)(0.0f), d = primary_direction(frame, px), weight = (float3)(1.0f);
        float traveled = 0.0f, spread = pixel_angle;
        __global const int *seen = tile_of(tiles, tile_stride, x, y, width);
        int skip = -1;
        bool flat_mirrors = true;
        for (int bounce = 0; bounce < MAX_BOUNCES; ++bounce) {
            const bool center = s == 0 && bounce == 0;
            Hit hit = {depth[i], object_id[i], keys[i] < 0 ? -1 : keys[i] / 8};
            int key = keys[i];
            if (!center) {
                hit = trace(w, o, d, seen, skip);
                key = surface_key(w, hit, o, d);
            }
            if (bounce == 0 && key != keys[i]) count = samples;
            const float3 eye = normalize(d);
            if (hit.prim < 0) {
                sum += weight * sky_color(w, eye, spread);
                break;
            }
            const float range = hit.t * length(d);
            traveled += range;
            __global const float4 *object = objects + hit.object * OBJECT_SIZE;
            const int type = prim_info[hit.prim].x, material_index = prim_info[hit.prim].y;
            const float4 a = prims[2 * hit.prim], b = prims[2 * hit.prim + 1];
            const float3 p = o + hit.t * d;
            const float3 p_local = move(object + 1, p);
            const float3 n_local = prim_normal(type, a, b, p_local);
            const float3 n = n_local.x * object[1].xyz + n_local.y * object[2].xyz + n_local.z * object[3].xyz;
            const float facing = clamp(-dot(n, eye), 0.0f, 1.0f);
            const float4 finish = materials[material_index * MATERIAL_SIZE + 2];

            float3 own = (float3)(0.0f);
            bool known = false;
            const int cache_key = key * 4 + bounce;
            for (int k = 0; k < 3; ++k) {
                if (known_key[k] == cache_key) {
                    own = known_color[k];
                    known = true;
                }
            }
            if (!known) {
                const float fp = traveled * spread / sqrt(max(facing, 0.04f));
                own = surface_color(w, material_index, p, n, eye, p_local, n_local, fp, hit.prim,
                                    max(weight.x, max(weight.y, weight.z)));
                if (bounce == 0 || flat_mirrors) {
                    known_key[oldest] = cache_key;
                    known_color[oldest] = own;
                    oldest = oldest == 2 ? 0 : oldest + 1;
                }
            }
            const float haze = 1.0f - exp(-frame[HAZE].w * range);
            const float grazing = 1.0f - facing;
            const float fresnel = grazing * grazing * grazing * grazing * grazing;
            sum += weight * (haze * frame[HAZE].xyz);
            weight *= 1.0f - haze;
            if (finish.w > 0.0f) {  /* glass: straight on, the reflection is the surroundings' mean */
                const float mirrored = finish.z + (1.0f - finish.z) * fresnel;
                sum += weight * (own + mirrored * frame[AMBIENT_UP].xyz);
                weight *= finish.w * (1.0f - mirrored) * materials[material_index * MATERIAL_SIZE].xyz;
                o = p;
                skip = hit.prim;
                seen = 0;
                d = eye;
                continue;
            }
            const float mirrored = finish.z * (finish.x + (1.0f - finish.x) * fresnel);
            sum += weight * (1.0f - mirrored) * own;
            if (mirrored < 0.015f) break;
            weight *= mirrored * (finish.x > 0.5f ? materials[material_index * MATERIAL_SIZE].xyz : (float3)(1.0f));
            if (finish.y < 0.05f) count = samples;
            /* A fan of directions for rough mirrors, another one for each phase. */
            const float turn_angle = 2.3999632f * (float)(s + phase * samples);
            const float away = ((float)s + 0.5f) / (float)samples + 0.61803399f * (float)phase;
            const float lean = finish.y * sqrt(away - floor(away));
            const bool upright = fabs(n.y) < 0.9f;
            const float3 side = normalize(cross(n, (float3)(upright ? 0.0f : 1.0f, upright ? 1.0f : 0.0f, 0.0f)));
            const float3 aside = cos(turn_angle) * side + sin(turn_angle) * cross(n, side);
            const float3 tilted = normalize(n + 0.5f * lean * aside);
            d = eye - 2.0f * dot(eye, tilted) * tilted;
            if (dot(d, n) < 0.01f) d = normalize(d + (0.01f - dot(d, n)) * n);
            o = p;
            skip = hit.prim;
            seen = 0;
            spread += finish.y * 0.3f + (type == BOX ? 0.0f : 0.01f);
            flat_mirrors = flat_mirrors && type == BOX;
        }
    }
    store_color(sum / (float)count, color, i);
}
