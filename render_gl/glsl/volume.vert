#version 330
// A volume of the depth passes, in planet radii: shell of air, shadow cone or occluder.

#include "eye.glsl"

uniform float size;   // factor on the mesh: the radius of a sphere, or 1
uniform vec3 origin;  // of the mesh in eye axes, relative to the planet's centre
in vec3 position;
out float mesh_depth;

void main() {
    vec3 eye = eye_position(size * position) + origin;
    mesh_depth = eye.z;
    gl_Position = clip_position(eye);
}
