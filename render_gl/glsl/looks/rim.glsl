// The look `rim`: a coat over the ground, denser towards the edge. Twin, with the formulas:
// model_jax.looks._rim, RimLook.air.

uniform float brightness;
uniform vec3 tint;       // factor per channel on the air's colour
uniform float opacity;
uniform float exponent;
uniform float slump;     // degrees
#ifdef TERM_GRADIENT
uniform float red[9];    // at 20, 40 ... 180 degrees, as a share of the light at 0
uniform float green[9];
uniform float blue[9];
#endif
#ifdef TERM_SPECULAR
uniform float specular;
uniform float shininess;
#endif

// sin x for 0 <= x <= pi / 2, to half an ulp of 1, which no driver has to promise.
float sine(float x) {
    float squared = x * x, sum = -1.0 / 39916800.0;
    sum = 1.0 / 362880.0 + squared * sum;
    sum = -1.0 / 5040.0 + squared * sum;
    sum = 1.0 / 120.0 + squared * sum;
    sum = -1.0 / 6.0 + squared * sum;
    return x + x * squared * sum;
}

float illumination(float sun_cos) {
    float night = sine(0.0174532925 * slump);
    float share = clamp((sun_cos + night) / (1.0 + night), 0.0, 1.0);
    return share * share * (3.0 - 2.0 * share);
}

const float DARKEST = 1e-18;  // least base of a power

float rim(float along, float impact) {
    float logarithm;
    if (2.0 * abs(along) < impact) {
        // log(1 + q) = 2 atanh(q / (2 + q)), exact where q is next to nothing.
        float ratio = along / impact, q = ratio * ratio, u = q / (2.0 + q), squared = u * u;
        logarithm = -u * (1.0 + squared * (1.0 / 3.0 + squared * (1.0 / 5.0 +
            squared * (1.0 / 7.0 + squared / 9.0))));
    } else {
        logarithm = log(max(impact / sqrt(impact * impact + along * along), DARKEST));
    }
    float steep = exponent * logarithm;
    return 0.3 + 0.2 * exp(steep) + 0.5 * exp(20.0 * steep);
}

#ifdef TERM_GRADIENT
// Cosines of 0, 20 ... 180 degrees.
const float PLACES_OF[10] = float[](1.0, 0.939692621, 0.766044443, 0.5, 0.173648178, -0.173648178,
    -0.5, -0.766044443, -0.939692621, -1.0);

vec3 gradient(float sun_cos) {
    vec3 total = vec3(0.0);
    for (int k = 0; k < 10; k++) {
        float share = 1.0;
        if (k > 0) share = min(share, (PLACES_OF[k - 1] - sun_cos) / (PLACES_OF[k - 1] - PLACES_OF[k]));
        if (k < 9) share = min(share, (sun_cos - PLACES_OF[k + 1]) / (PLACES_OF[k] - PLACES_OF[k + 1]));
        vec3 node = k == 0 ? vec3(1.0) : vec3(red[max(k - 1, 0)], green[max(k - 1, 0)], blue[max(k - 1, 0)]);
        total += max(share, 0.0) * node;
    }
    return total;
}
#endif

vec3 air(Fields fields, inout float alpha, inout vec3 transmittance) {
#ifdef TERM_SINGLE
    float at = fields.end, sun_cos = fields.end_sun_cos, here = fields.planet > 0.0 ? 1.0 : 0.0;
#else
    float at = fields.begin, sun_cos = fields.begin_sun_cos, here = 1.0;
#endif
    alpha = here * opacity * illumination(sun_cos) * rim(at, fields.impact);
    vec3 color = brightness * (fields.color * tint);
#ifdef TERM_GRADIENT
    color *= gradient(sun_cos);
#endif
    vec3 light = color * alpha;
#ifdef TERM_SPECULAR
    float length_ = sqrt(fields.impact * fields.impact + fields.end * fields.end);
    float toward = fields.sun_cos - 2.0 * fields.end_sun_cos * fields.end / length_;
    float power = exp(shininess * log(clamp(toward, DARKEST, 1.0)));
    light += (1.0 - alpha) * specular * fields.water * max(fields.end_sun_cos, 0.0) * power;
#endif
    transmittance = vec3(1.0 - fields.planet * (1.0 - illumination(fields.end_sun_cos)));
    return light;
}
