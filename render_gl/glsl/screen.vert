#version 330
// One triangle over the whole picture at the near plane: the front of the air for a camera inside.

uniform vec2 clip_planes;
out float mesh_depth;

void main() {
    vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    mesh_depth = clip_planes.x;
    gl_Position = vec4(corner, -1.0, 1.0);
}
