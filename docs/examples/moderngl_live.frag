#version 330
uniform vec3 lamp, tint;
uniform vec2 size;
in vec3 place, world;
in vec4 clip, old_clip;
layout(location = 0) out vec4 color;     // linear
layout(location = 1) out vec4 geometry;  // depth along the view, motion in pixels with y down
void main() {
    vec3 up = normalize(cross(dFdx(world), dFdy(world))), to_lamp = lamp - world, cell = floor(place * 2 + 1e-3);
    float light = 0.2 + 8 * max(dot(up, normalize(to_lamp)), 0) / (3 + dot(to_lamp, to_lamp));
    color = vec4(tint * light * (0.6 + 0.4 * mod(cell.x + cell.y + cell.z, 2)), 1);
    vec2 motion = (old_clip.xy / old_clip.w - clip.xy / clip.w) * 0.5 * size * vec2(1, -1);
    geometry = vec4(clip.w, motion, 1);
}
