#version 330
// Passes 1, 2 and 4. Window formats: the depth buffer is the result and nothing is written here.
// LINEAR: eye depth relative to the planet's centre, in scene length units.

uniform float length_unit;  // planet radius
uniform vec2 clip_planes;
in float relative_depth;

#ifdef LINEAR
out float depth;

void main() {
    depth = clamp(relative_depth, clip_planes.x, clip_planes.y) * length_unit;
}
#else
void main() {}
#endif
