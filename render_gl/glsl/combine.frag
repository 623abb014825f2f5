#version 330
// Pass 5: reads the depths of its pixel, hands on its own and the one behind, and combines them.

#include "combine.glsl"
#include "depth_code.glsl"

#ifdef STRETCH
uniform float pixel_size;             // side of a pixel at eye depth 1
uniform vec2 principal;               // where the camera's axis goes through this band
#endif
uniform sampler2D planet_atmosphere;  // PlAtDepth of the paper
#ifdef SHADOWS
uniform sampler2D shadow_depths;      // front and back of each shadow, one above the other
uniform int band_rows;
#endif

layout(location = 0) out vec4 air;
layout(location = 1) out float front;
layout(location = 2) out float back;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    front = coded_depth();
    back = texelFetch(planet_atmosphere, pixel, 0).r;
    // Ground that rises out of the air, or a body before it, hides it.
    if (!is_nearer(front, back)) discard;
    float depths[DEPTHS];
    depths[0] = front;
    depths[1] = back;
#ifdef SHADOWS
    for (int k = 0; k < 2 * SHADOWS; k++)
        depths[2 + k] = texelFetch(shadow_depths, pixel + ivec2(0, k * band_rows), 0).r;
#endif
#ifdef STRETCH
    air = combine(depths, length(vec3(pixel_size * (gl_FragCoord.xy - principal), 1.0)));
#else
    air = combine(depths, 1.0);
#endif
}
