#version 330
// Linearises the window depths of a texture, to measure how this driver divides.

#include "fields.glsl"

uniform sampler2D windows;
layout(location = 0) out float depth;

void main() {
    depth = linearize_depth(texelFetch(windows, ivec2(gl_FragCoord.xy), 0).r);
}
