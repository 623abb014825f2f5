#version 330
// Passes 1, 2 and 4. COLOR_DEPTH: depths go to a colour attachment; else the depth buffer is the
// result and nothing is written here.

#ifdef COLOR_DEPTH
#include "depth_code.glsl"

out float depth;

void main() {
    depth = coded_depth();
}
#else
void main() {}
#endif
