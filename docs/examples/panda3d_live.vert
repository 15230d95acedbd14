#version 330
uniform mat4 p3d_ModelViewProjectionMatrix, p3d_ModelViewMatrix, p3d_ModelMatrix, present_clip, previous_clip, moved;
in vec4 p3d_Vertex; in vec3 p3d_Normal, shift; in vec2 p3d_MultiTexCoord0;  // shift: to where a vertex was before
out vec4 clip, old_clip; out vec3 world, normal; out vec2 uv; out float depth;
void main() {
    gl_Position = p3d_ModelViewProjectionMatrix * p3d_Vertex;  // with jitter, if there is any
    clip = present_clip * p3d_ModelMatrix * p3d_Vertex;
    old_clip = previous_clip * moved * p3d_ModelMatrix * (p3d_Vertex + vec4(shift, 0));
    world = (p3d_ModelMatrix * p3d_Vertex).xyz;
    normal = mat3(p3d_ModelMatrix) * p3d_Normal;
    uv = p3d_MultiTexCoord0;
    depth = -(p3d_ModelViewMatrix * p3d_Vertex).z;
}
