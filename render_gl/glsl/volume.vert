#version 330
// A volume of the depth passes: shell of air or shadow cone, in planet radii.

#include "eye.glsl"

uniform float size;  // factor on the mesh: the shell's radius, or 1
in vec3 position;
out float relative_depth;

void main() {
    vec3 eye = eye_position(size * position);
    relative_depth = eye.z;
    gl_Position = clip_position(eye);
}
