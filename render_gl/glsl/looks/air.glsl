// The look `air`: air that may thin out, end lower than the shell, and dim itself. Twin: AirLook.air
// in model_jax. TERM_...: what it is made of; lines of other terms are taken out beforehand.

uniform float brightness;
uniform vec3 shadow;  // light of shadowed air as a share of lit air, per channel
uniform vec3 tint;    // factor per channel on the air's colour
#ifdef TERM_DENSITY
uniform float scale_height;
#endif
#ifdef TERM_DENSITY_RGB
uniform vec3 scale_height;
#endif
#ifdef TERM_TOP
uniform float top;
#endif
#ifdef TERM_SATURATION
uniform vec3 extinction;  // optical depth of a width unit
#endif

vec3 air(Fields fields, inout float alpha, inout vec3 transmittance) {
    vec3 lit, dark;
#ifdef FIELD_IMPACT
    vec2 whole = vec2(fields.begin, fields.end), shaded = vec2(fields.begin);
#ifdef SHADOWS
    shaded = vec2(fields.dark_begin, fields.dark_end);
#endif
#ifdef TERM_TOP
    float half_chord = sqrt(max((top - fields.altitude) *
        (2.0 * fields.impact - fields.altitude + top), 0.0));
    whole = clamp(whole, -half_chord, half_chord);
    shaded = clamp(shaded, whole.x, whole.y);
#endif
    float cuts[PIECES + 1];
    bool in_shadow[PIECES];
    pieces(whole, shaded, cuts, in_shadow);
    lit = vec3(0.0);
    dark = vec3(0.0);
    for (int k = 0; k < PIECES; k++) {
        float one = abs(cuts[k]), other = abs(cuts[k + 1]);
        if (one == other) continue;
        vec3 here = vec3(max(one, other) - min(one, other));
#ifdef TERM_DENSITY
        here = vec3(column(min(one, other), max(one, other), fields.altitude, fields.impact,
            scale_height));
#endif
#ifdef TERM_DENSITY_RGB
        for (int c = 0; c < 3; c++)
            here[c] = column(min(one, other), max(one, other), fields.altitude, fields.impact,
                scale_height[c]);
#endif
        if (in_shadow[k]) dark += here; else lit += here;
    }
    lit *= fields.per_length;
    dark *= fields.per_length;
#endif
#ifndef FIELD_IMPACT
    lit = vec3(fields.lit);
    dark = vec3(fields.dark);
#endif
    vec3 light = brightness * (fields.color * tint * (lit + shadow * dark));
#ifdef TERM_SATURATION
    vec3 depth = extinction * max(lit + dark, 0.0);
    transmittance = exp(-depth);
    light *= mean_transmittance(depth);
#endif
    return light;
}
