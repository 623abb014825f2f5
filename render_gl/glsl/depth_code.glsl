// What a depth texture holds of a fragment. LINEAR: eye depth relative to the planet's centre, in
// scene length units. REVERSED: near (far - z) / (z (far - near)), 1 at the near plane and 0 at the
// far one. Neither: window depth, far (z - near) / (z (far - near)); of a mesh, unless EXACT, as the
// depth buffer has it.

uniform float length_unit;     // planet radius
uniform vec2 clip_planes;      // near and far relative to the planet's centre, planet radii
uniform vec2 eye_reference;    // eye depth of the planet's centre and of the near plane, radii
uniform float reversed_factor; // near / (far - near)
uniform float window_factor;   // far / (far - near)

#ifdef SORTED
uniform vec2 body_depths;      // between which planet and occluders lie, as clip_planes

// What the depth buffer sorts bodies by, linear in eye depth: window depth may be 1 for all of them.
float sorting_depth(float relative_depth) {
    float share = (relative_depth - body_depths.x) / (body_depths.y - body_depths.x);
    return clamp(share, 0.0, 1.0);
}
#endif

// relative_depth: eye depth relative to the planet's centre, planet radii.
float coded_depth(float relative_depth) {
    float depth = clamp(relative_depth, clip_planes.x, clip_planes.y);
#ifdef LINEAR
    return depth * length_unit;
#else
    float eye_depth = max(depth + eye_reference.x, eye_reference.y);
#ifdef REVERSED
    return min(reversed_factor * (clip_planes.y - depth) / eye_depth, 1.0);
#else
#ifdef EXACT
    return clamp(window_factor * (depth - clip_planes.x) / eye_depth, 0.0, 1.0);
#else
    return clamp(gl_FragCoord.z, 0.0, 1.0);
#endif
#endif
#endif
}
