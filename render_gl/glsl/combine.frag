#version 330
// Pass 5: reads the four depths of its pixel, hands them on as they are, and combines them.

#include "combine.glsl"

uniform float length_unit;
uniform vec2 clip_planes;
uniform sampler2D planet_atmosphere;  // PlAtDepth of the paper
#ifdef SHADOW
uniform sampler2D shadow_front_texture;
uniform sampler2D shadow_back_texture;
#endif
uniform float empty;                  // clear value of the depth textures: nothing was drawn
in float relative_depth;

layout(location = 0) out vec4 air;
layout(location = 1) out vec4 depths;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
#ifdef LINEAR
    float front = clamp(relative_depth, clip_planes.x, clip_planes.y) * length_unit;
#else
    float front = clamp(gl_FragCoord.z, 0.0, 1.0);
#endif
    float back = texelFetch(planet_atmosphere, pixel, 0).r;
    // Ground that rises out of the air hides it.
    if (front >= back) discard;
#ifdef SHADOW
    depths = vec4(front, back, texelFetch(shadow_front_texture, pixel, 0).r,
                  texelFetch(shadow_back_texture, pixel, 0).r);
#else
    depths = vec4(front, back, empty, empty);
#endif
    air = combine(depths);
}
