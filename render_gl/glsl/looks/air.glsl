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
#else
#ifdef TERM_SUN
uniform vec3 extinction;
#endif
#endif
#ifdef TERM_UPWELLING
uniform vec3 upwelling;  // light from below under the sun in the zenith, as a share of sunlight
#endif
#ifdef TERM_PHASE
uniform float aerosol;    // share of the scattered light that haze scatters
uniform float asymmetry;  // mean cosine by which it turns light
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
#ifdef TERM_SUN
    vec3 upward = vec3(0.0);
    float top_of_air = fields.shell;
#ifdef TERM_TOP
    top_of_air = min(top, top_of_air);
#endif
    vec3 columns = vec3(0.0);
    for (int c = 0; c < 3; c++) {
        float optical = extinction[c] * fields.per_length, dimming = 0.0;
        vec3 shares;
#ifdef TERM_SATURATION
        dimming = optical;
#endif
        sunlight_met(cuts, in_shadow, fields.altitude, fields.impact,
#ifdef TERM_DENSITY_RGB
            scale_height[c],
#else
            scale_height,
#endif
            fields.sunward, fields.sun_cos, top_of_air, optical, dimming, columns[c], shares);
        columns[c] *= fields.per_length;
        lit[c] = columns[c] * shares.x;
        dark[c] = columns[c] * shares.y;
        upward[c] = columns[c] * shares.z;
    }
#else
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
#endif
#ifndef FIELD_IMPACT
    lit = vec3(fields.lit);
    dark = vec3(fields.dark);
#endif
    vec3 width = lit + dark;
#ifdef TERM_SUN
    width = columns;
#endif
#ifdef TERM_PHASE
    float haze = henyey_greenstein(fields.sun_cos, asymmetry);
    lit *= (1.0 - aerosol) * rayleigh(fields.sun_cos) + aerosol * haze;
#endif
    vec3 sent = lit + shadow * dark;
#ifdef TERM_UPWELLING
    sent += upwelling * upward;
#endif
    vec3 light = brightness * (fields.color * tint * sent);
#ifdef TERM_SUN
    vec2 place = place_at(fields.end, fields.altitude, fields.impact);
    float sunward = clamp(fields.sunward + fields.end * fields.sun_cos, -place.y, place.y);
    // Of rays that leave the air what lies behind them has a light of its own.
    bool ends = fields.end < 0.0 || place.x < on_ground * fields.shell;
    for (int c = 0; c < 3 && ends; c++)
        transmittance[c] = exp(-extinction[c] * fields.per_length *
            sun_column_at(sunward, place.y, place.x, top_of_air,
#ifdef TERM_DENSITY_RGB
                scale_height[c]));
#else
                scale_height));
#endif
#endif
#ifdef TERM_SATURATION
    vec3 depth = extinction * max(width, 0.0);
    transmittance *= exp(-depth);
    light *= mean_transmittance(depth);
#endif
    return light;
}
