#version 450
// A cube of 36 vertices, seen now and at the time of the frame before.
layout(push_constant) uniform Matrices {
    mat4 clip_from_model;
    mat4 old_clip_from_model;
};
layout(location = 0) out vec4 clip;
layout(location = 1) out vec4 old_clip;
layout(location = 2) out vec3 place;
layout(location = 3) flat out vec3 normal;
layout(location = 4) flat out int number;

void main() {
    const vec2 corners[6] = vec2[](vec2(-1, -1), vec2(1, -1), vec2(1, 1), vec2(-1, -1), vec2(1, 1), vec2(-1, 1));
    int face = gl_VertexIndex / 6, axis = face % 3;
    vec3 point = vec3(corners[gl_VertexIndex % 6], face < 3 ? 1 : -1);
    vec3 up = vec3(0, 0, point.z);
    place = axis == 0 ? point.zxy : axis == 1 ? point.yzx : point;
    normal = axis == 0 ? up.zxy : axis == 1 ? up.yzx : up;
    number = gl_InstanceIndex;
    clip = clip_from_model * vec4(place, 1);
    old_clip = old_clip_from_model * vec4(place, 1);
    gl_Position = clip;
}
