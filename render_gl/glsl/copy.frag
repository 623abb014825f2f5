#version 330
// Hands on what a shader reads in a texture: formats differ in how they become float32.

uniform sampler2D depths;
layout(location = 0) out float depth;

void main() {
    depth = texelFetch(depths, ivec2(gl_FragCoord.xy), 0).r;
}
