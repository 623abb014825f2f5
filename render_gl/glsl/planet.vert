#version 330
// Pass 3: the planet's sphere, displaced by its height map. RELIEF when there is one.

#include "eye.glsl"
#include "sphere_map.glsl"

in vec3 position;
out float mesh_depth;
out vec3 direction;

#ifdef RELIEF
uniform sampler2D relief;     // heights in planet radii
uniform float relief_scale;   // exaggeration at this camera distance

float ground_radius(vec3 at) {
    return 1.0 + relief_scale * textureLod(relief, map_position(at), 0.0).r;
}
#else
float ground_radius(vec3 at) {
    return 1.0;
}
#endif

void main() {
    direction = position;
    vec3 eye = eye_position(ground_radius(position) * position);
    mesh_depth = eye.z;
    gl_Position = clip_position(eye);
}
