/* Composition of what lies over the picture and is not warped with it: pixels that stay in place, effects without
   depth, the user interface. Layers are linear RGB, premultiplied: layer + (1 - A) * picture. A mapping is (scale x,
   scale y, offset x, offset y) from pixels of the display to pixels of the rendered image.

   `fixed_mask`, `effects` and `effects_motion` have the size of the rendered image, the others that of the display.
   `color` is the picture without any of them. Depth, motion and labels change where pixels stay in place. */

#include "frame.h"

#define EFFECT_APPROACHES 3  /* of the effects' position to where they come from */

/* Depth without overlays that stay in place: no stage splats, collects or meets them. */
__kernel void leave_out_fixed(__constant Frame *restrict frame, __global const float *depth,
                              __global const uchar *fixed_mask, __global float *out_depth) {
    const int x = get_global_id(0), y = get_global_id(1), i = y * frame->source_width + x;
    if (x >= frame->source_width || y >= frame->source_height) return;
    out_depth[i] = fixed_mask[i] ? NAN : depth[i];
}

/* A texel of a layer; NaN is transparent. */
INLINE float4 load_layer(__global const half *layer, const int i) {
    const float4 c = load_texel(i, layer);
    return (float4)(load_color(layer, i), isnan(c.w) ? 0.0f : clamp(c.w, 0.0f, 1.0f));
}

/* A layer at px, bilinear; transparent beyond the image. */
INLINE float4 layer_at(__global const half *layer, const float2 px, const int width, const int height) {
    const float2 corner = px - 0.5f, first = floor(corner), part = corner - first;
    float4 sum = (float4)(0.0f);
    for (int tap = 0; tap < 4; ++tap) {
        const float2 at = first + (float2)((float)(tap & 1), (float)(tap >> 1));
        const float weight = bilinear_weight(tap, part.x, part.y);
        if (weight > 0.0f && holds(width, height, at)) sum += weight * load_layer(layer, (int)at.y * width + (int)at.x);
    }
    return sum;
}

INLINE float3 over(const float4 layer, const float3 picture) { return layer.xyz + (1.0f - layer.w) * picture; }

/* Effects continue along their own motion: the effect at px at t + alpha was at s = px + alpha * motion[s] at t. */
INLINE float2 effects_origin(const float2 px, const float alpha, __global const float2 *motion, const int width,
                             const int height) {
    float2 origin = px;
    for (int k = 0; k < EFFECT_APPROACHES; ++k) {
        const float2 place = floor(origin);
        if (!holds(width, height, place)) break;
        const float2 moved = alpha * motion[(int)place.y * width + (int)place.x];
        if (!isfinite(moved.x) || !isfinite(moved.y)) break;
        origin = px + moved;
    }
    return origin;
}

__kernel void compose(__constant Frame *restrict frame, const int is_rendered, __global const uchar *fixed_mask,
                      __global const half *effects, __global const float2 *effects_motion, __global const half *ui,
                      __global const half *source_color, __global const float *source_depth, __global const half *color,
                      __global half *out_color, __global float *depth, __global float2 *motion, __global uchar *dynamic,
                      __global uchar *disoccluded, __global uchar *filled_by) {
    const int source_width = frame->source_width, source_height = frame->source_height;
    const int x = get_global_id(0), y = get_global_id(1), dst = y * frame->target_width + x;
    if (x >= frame->target_width || y >= frame->target_height) return;
    const float2 px = pixel_center(x, y), px_render = px * frame->to_render.xy + frame->to_render.zw;
    float3 picture = load_color(color, dst);
    if ((frame->has_overlays & FIXED_MASK) && !is_rendered) {
        const float2 place = floor(px_render);
        const bool rendered = holds(source_width, source_height, place);
        const int src = rendered ? (int)place.y * source_width + (int)place.x : 0;
        if (rendered && fixed_mask[src]) {
            picture = load_color(source_color, src);
            if (!INVALID_DEPTH(source_depth[src])) depth[dst] = source_depth[src]; /* else that of what is behind */
            motion[dst] = px_render - px;
            dynamic[dst] = 0;
            disoccluded[dst] = 0;
            filled_by[dst] = BY_FIXED;
        }
    }
    if (frame->has_overlays & EFFECTS) {
        const float alpha = is_rendered ? 0.0f : frame->alpha;
        float2 from = px_render;
        if (frame->has_overlays & EFFECTS_MOTION)
            from = effects_origin(px_render, alpha, effects_motion, source_width, source_height);
        picture = over(layer_at(effects, from, source_width, source_height), picture);
    }
    if (frame->has_overlays & USER_INTERFACE) picture = over(load_layer(ui, dst), picture);
    store_color(picture, out_color, dst);
}
