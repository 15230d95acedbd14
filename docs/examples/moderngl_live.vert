#version 330
uniform mat4 clip_from_world, old_clip_from_world, world_from_model, old_world_from_model;
out vec3 place, world;
out vec4 clip, old_clip;
void main() {
    int bit = 1 << gl_VertexID;  // a strip of 14 vertices is a cube from -1 to 1
    vec3 position = 2 * vec3((0x287a & bit) != 0, (0x02af & bit) != 0, (0x31e3 & bit) != 0) - 1;
    mat3 axes = mat3(world_from_model);
    place = position * vec3(length(axes[0]), length(axes[1]), length(axes[2]));  // the pattern moves with its box
    world = (world_from_model * vec4(position, 1)).xyz;
    clip = gl_Position = clip_from_world * vec4(world, 1);
    old_clip = old_clip_from_world * old_world_from_model * vec4(position, 1);
}
