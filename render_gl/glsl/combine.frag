#version 330
// Pass 5: reads the depths of its pixel, hands on its own and the one behind, and combines them.
// EXACT: its own is where the pixel's ray enters the shell; else the mesh's.

#include "rays.glsl"
#include "combine.glsl"
#include "depth_code.glsl"

uniform sampler2D planet_atmosphere;  // PlAtDepth of the paper
#ifdef SHADOWS
uniform sampler2D shadow_depths;      // front and back of each shadow, one above the other
uniform int band_rows;
#endif
#ifndef EXACT
in float mesh_depth;
#endif

layout(location = 0) out vec4 air;
layout(location = 1) out float front;
layout(location = 2) out float back;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
#ifdef EXACT
    bool hit;
    front = coded_depth(ray_sphere(ray_direction(), ray_offset(), hit).x);
    if (!hit) discard;
#else
    front = coded_depth(mesh_depth);
#endif
    back = texelFetch(planet_atmosphere, pixel, 0).r;
    // Ground that rises out of the air, or a body before it, hides it.
    if (!is_nearer(front, back)) discard;
    float depths[DEPTHS];
    depths[0] = front;
    depths[1] = back;
#ifdef SHADOWS
    for (int k = 0; k < 2 * SHADOWS; k++)
        depths[2 + k] = texelFetch(shadow_depths, pixel + ivec2(0, k * band_rows), 0).r;
#ifndef EXACT
    // On a mesh's outline a back may be drawn where its front is not: that is no shadow.
    for (int k = 2; k < DEPTHS; k += 2)
        if (is_nearer(depths[k + 1], depths[k])) depths[k] = depths[k + 1];
#endif
#endif
#ifdef STRETCH
    air = combine(depths, length(vec3(ray_direction(), 1.0)));
#else
    air = combine(depths, 1.0);
#endif
}
