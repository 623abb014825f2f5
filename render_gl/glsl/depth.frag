#version 330
// Passes 1, 2 and 4. EXACT: where the pixel's ray enters or leaves a volume, of which the mesh only
// bounds the pixels; CONE: the volume is a shadow. Else the mesh's own depth. COLOR_DEPTH: depths go
// to a colour attachment; else the depth buffer is the result.

#ifdef EXACT
#include "rays.glsl"
uniform bool leaving;
#else
in float mesh_depth;
#endif
#include "depth_code.glsl"
#ifdef COLOR_DEPTH
out float depth;
#endif

void main() {
#ifdef EXACT
#ifdef CONE
    // Both ends come from one ray: a pixel has both of them or none.
    vec2 ends = clamp(ray_cone(ray_direction(), ray_offset()), clip_planes.x, clip_planes.y);
    if (!(ends.y > ends.x)) discard;
#else
    bool hit;
    vec2 ends = ray_sphere(ray_direction(), ray_offset(), hit);
    if (!hit) discard;
#endif
    float found = coded_depth(leaving ? ends.y : ends.x);
#ifdef COLOR_DEPTH
    depth = found;
#else
    gl_FragDepth = found;
#endif
#else
#ifdef COLOR_DEPTH
    depth = coded_depth(mesh_depth);
#endif
#endif
}
