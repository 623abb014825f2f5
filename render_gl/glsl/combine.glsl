// The combine step of the paper (section 4, "Pixel Shader code"): four depths -> widths -> colour.
// Twins: linearize_depth, layer_widths and combine in model_jax. Defines: LINEAR when the depths are
// eye depths already, SHADOW when the scene has a shadow volume.

uniform vec2 depth_constants;  // a, b of the depth linearisation; unused when LINEAR
uniform float width_unit;      // far - near, scene length units
uniform float brightness;
uniform vec3 shadow;           // shadow weight per channel
uniform vec3 tint;             // factor per channel on the air's colour
uniform vec4 color;            // the air's: linear rgb, and alpha

float linearize_depth(float window) {
    return depth_constants.y / (window - depth_constants.x);
}

float eye_depth(float value) {
#ifdef LINEAR
    return value;
#else
    return linearize_depth(value);
#endif
}

// depths: front, back, shadow front, shadow back. Returns the lit and the dark width.
vec2 layer_widths(vec4 depths) {
    float front = eye_depth(depths.x);
    float back = eye_depth(depths.y);
#ifdef SHADOW
    float shadow_back = eye_depth(min(max(depths.w, depths.x), depths.y));
    float shadow_front = eye_depth(min(max(depths.z, depths.x), depths.y));
    vec2 widths = vec2((back - shadow_back) + (shadow_front - front), shadow_back - shadow_front);
#else
    vec2 widths = vec2(back - front, 0.0);
#endif
    return widths / width_unit;
}

vec4 combine(vec4 depths) {
    vec2 widths = layer_widths(depths);
#ifdef SHADOW
    vec3 light = color.rgb * tint * (widths.x + shadow * widths.y);
#else
    vec3 light = color.rgb * tint * widths.x;
#endif
    return vec4(brightness * light, depths.x != depths.y ? color.a : 0.0);
}
