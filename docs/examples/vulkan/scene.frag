#version 450
// Color, planar depth, and motion: from here to the position in the frame before, in pixels, y down.
layout(constant_id = 0) const float width = 1;
layout(constant_id = 1) const float height = 1;
layout(location = 0) in vec4 clip;
layout(location = 1) in vec4 old_clip;
layout(location = 2) in vec3 place;
layout(location = 3) flat in vec3 normal;
layout(location = 4) flat in int number;
layout(location = 0) out vec4 color;
layout(location = 1) out float depth;
layout(location = 2) out vec2 motion;

void main() {
    vec3 across = place * (number == 0 ? 11.99 : 1.99), finest = fwidth(across);
    ivec3 square = ivec3(floor(across));
    float pattern = ((square.x + square.y + square.z) & 1) == 0 ? 1.0 : 0.6;
    pattern = mix(pattern, 0.8, clamp(2 * max(finest.x, max(finest.y, finest.z)), 0, 1)); // where squares get too small
    vec3 tint = number == 0 ? vec3(0.5, 0.5, 0.45) : 0.5 + 0.4 * cos(number + vec3(0, 2, 4));
    color = vec4(tint * pattern * (0.5 + 0.5 * abs(dot(normal, vec3(0.3, 0.8, 0.5)))), 1);
    depth = clip.w;
    motion = (old_clip.xy / old_clip.w - clip.xy / clip.w) * 0.5 * vec2(width, height);
}
