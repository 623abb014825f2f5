#version 330
// Pass 3, occluders: black, with coverage 1 in alpha. COLOR_DEPTH adds the depth.

layout(location = 0) out vec4 surface;
#ifdef COLOR_DEPTH
#include "depth_code.glsl"
layout(location = 1) out float depth;
#endif

void main() {
    surface = vec4(0.0, 0.0, 0.0, 1.0);
#ifdef COLOR_DEPTH
    depth = coded_depth();
#ifdef SORTED
    gl_FragDepth = sorting_depth();
#endif
#endif
}
