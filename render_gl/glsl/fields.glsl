// The combine step of the paper (section 4, "Pixel Shader code") up to its widths: depths -> fields.
// Twins: linearize_depth and layer_widths in model_jax. Defines: LINEAR when the depths are eye depths
// already, REVERSED when nearer is more, SHADOWS = how many shadow volumes there are, absent for none.

uniform vec2 depth_constants;  // a, b of the depth linearisation; unused when LINEAR
uniform vec2 plane_depths;     // near and far; unused when LINEAR
uniform float width_unit;      // far - near, scene length units

#ifdef REVERSED
#define NEARER max
#define FARTHER min
#define AT_NEAR 1.0
#define AT_FAR 0.0
bool is_nearer(float one, float other) { return one > other; }
#else
#define AT_NEAR 0.0
#define AT_FAR 1.0
#define NEARER min
#define FARTHER max
bool is_nearer(float one, float other) { return one < other; }
#endif

float linearize_depth(float window) {
    if (window == AT_NEAR) return plane_depths.x;
    if (window == AT_FAR) return plane_depths.y;
    float depth = depth_constants.y / (window - depth_constants.x);
    return clamp(depth, plane_depths.x, plane_depths.y);
}

float eye_depth(float value) {
#ifdef LINEAR
    return value;
#else
    return linearize_depth(value);
#endif
}

#ifdef SHADOWS
#define DEPTHS (2 + 2 * SHADOWS)
#else
#define DEPTHS 2
#endif

// depths: front, back, and front and back of each shadow; stretch: length along the ray for each unit
// of eye depth, or 1. Returns the lit and the dark width.
vec2 layer_widths(float depths[DEPTHS], float stretch) {
    float front = eye_depth(depths[0]);
    float back = eye_depth(depths[1]);
#ifndef SHADOWS
    vec2 widths = vec2(back - front, 0.0);
#elif SHADOWS == 1
    float shadow_front = eye_depth(NEARER(FARTHER(depths[2], depths[0]), depths[1]));
    float shadow_back = eye_depth(NEARER(FARTHER(depths[3], depths[0]), depths[1]));
    vec2 widths = vec2((back - shadow_back) + (shadow_front - front), shadow_back - shadow_front);
#else
    // In the order of their fronts, each shadow adds what lies beyond all that ended before.
    vec2 shadows[SHADOWS];
    for (int k = 0; k < SHADOWS; k++) {
        vec2 here;
        for (int end = 0; end < 2; end++)
            here[end] =
                eye_depth(NEARER(FARTHER(depths[2 + 2 * k + end], depths[0]), depths[1]));
        int at = k;
        for (; at > 0 && shadows[at - 1].x > here.x; at--) shadows[at] = shadows[at - 1];
        shadows[at] = here;
    }
    vec2 widths = vec2(0.0);
    float reached = front;
    for (int k = 0; k < SHADOWS; k++) {
        widths += max(vec2(shadows[k].x - reached, shadows[k].y - max(shadows[k].x, reached)), 0.0);
        reached = max(reached, shadows[k].y);
    }
    widths.x += back - reached;
#endif
    return widths * stretch / width_unit;
}
