#version 330
// Pass 3, occluders: black, with coverage 1 in alpha. LINEAR adds the depth.

uniform float length_unit;
uniform vec2 clip_planes;
in float relative_depth;

layout(location = 0) out vec4 surface;
#ifdef LINEAR
layout(location = 1) out float depth;
#endif

void main() {
    surface = vec4(0.0, 0.0, 0.0, 1.0);
#ifdef LINEAR
    depth = clamp(relative_depth, clip_planes.x, clip_planes.y) * length_unit;
#endif
}
