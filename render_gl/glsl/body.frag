#version 330
// Pass 3, occluders: black, with coverage 1 in alpha. EXACT: the pixel's ray is asked, and the mesh
// only bounds the pixels. COLOR_DEPTH adds the depth, WATER says where to write that nothing mirrors.

#ifdef EXACT
#include "rays.glsl"
uniform float center_offset;  // eye depth of the body's centre relative to the planet's
#else
in float mesh_depth;
#endif
#include "depth_code.glsl"

layout(location = 0) out vec4 surface;
#ifdef COLOR_DEPTH
layout(location = 1) out float depth;
#endif
#ifdef WATER
layout(location = WATER) out float mirrors;
#endif

void main() {
#ifdef EXACT
    bool hit;
    vec2 d = ray_direction();
    float met = ray_sphere(d, ray_offset(), hit).x + center_offset;
    if (!hit || !is_ahead(d)) discard;
#ifndef COLOR_DEPTH
    gl_FragDepth = coded_depth(met);
#endif
#else
    float met = mesh_depth;
#endif
    surface = vec4(0.0, 0.0, 0.0, 1.0);
#ifdef WATER
    mirrors = 0.0;
#endif
#ifdef COLOR_DEPTH
    depth = coded_depth(met);
#ifdef SORTED
    gl_FragDepth = sorting_depth(met);
#endif
#endif
}
