// From planet-centred world axes, in planet radii, to clip space. Depth is kept relative to the
// planet's centre as long as possible: subtracting two depths of a far camera would cost the digits.

uniform mat3 basis;        // world -> eye axes: right, up, forward
uniform vec2 center;       // planet's centre in eye axes, right and up
uniform float center_depth;
uniform vec2 clip_planes;  // near and far relative to the planet's centre
uniform vec2 clip_factors; // far / (far - near), near / (far - near)
uniform vec2 focal;        // 1 / tan of half the horizontal and the vertical field of view

// Returns the eye position: right, up, and depth relative to the planet's centre.
vec3 eye_position(vec3 world) {
    return basis * world + vec3(center, 0.0);
}

vec4 clip_position(vec3 eye) {
    vec2 beyond = eye.z - clip_planes;  // depth beyond the near and the far plane
    float depth = clip_factors.x * beyond.x + clip_factors.y * beyond.y;
    return vec4(focal * eye.xy, depth, eye.z + center_depth);
}
