#version 330
uniform sampler2D p3d_Texture0; uniform vec3 lamp; uniform vec2 size;
in vec4 clip, old_clip; in vec3 world, normal; in vec2 uv; in float depth;
layout(location = 0) out vec4 color; layout(location = 1) out vec4 geometry;
void main() {
    vec4 texel = texture(p3d_Texture0, uv);
    if (texel.a < 0.5) discard;
    vec3 n = normalize(gl_FrontFacing ? normal : -normal), to_lamp = lamp - world;
    float light = 0.35 + 0.4 * max(n.z, 0) + 60 * max(dot(n, normalize(to_lamp)), 0) / (20 + dot(to_lamp, to_lamp));
    color = vec4(pow(texel.rgb, vec3(2.2)) * light, 1);  // linear
    vec2 motion = (old_clip.xy / old_clip.w - clip.xy / clip.w) * 0.5 * size * vec2(1, -1);  // pixels, y down
    geometry = vec4(depth, motion, 1);
}
