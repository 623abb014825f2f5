// The look `gradient`: a sky by brightness and height. Twin, with the formulas:
// model_jax.looks._gradient, GradientLook.air. INSIDE: the camera is in the air, where no ray's near
// point has to be found.

uniform float falloff;
uniform vec3 tint;       // factor per channel on the air's colour
uniform float opacity;
uniform float stretch;
uniform float tweak;
#ifdef TERM_TABLE
uniform float red[31];   // of 8 brightnesses the 4 heights each, as a share of the last
uniform float green[31];
uniform float blue[31];
uniform float cover[31];
#endif
#ifdef TERM_MIE
uniform float asymmetry;
#endif
#ifdef TERM_LAMP
uniform float light_distance;  // planet radii
#endif

// Height and the same as it is raised, brightness and its place in the table.
vec4 sky(Fields fields) {
    float shell = fields.shell, radius = fields.radius, whole = fields.ground_horizon;
    float far = radius + fields.eye_height;
    float across = shell * (2.0 * radius + shell);  // air's edge squared less the ground's
    float slight = min(tweak, 0.5 * sqrt(across) / (radius + shell));
    float deep = fields.eye_height / shell - (1.0 - slight);
#ifdef INSIDE
    float rim = 0.0, edge = fields.nadir_cos, horizon = whole, near = fields.eye_sun_cos;
#else
    float rim = fields.shell_horizon, near = fields.begin_sun_cos;
    float edge = (shell - fields.altitude) * (radius + shell + fields.impact) /
        (far * far * (fields.nadir_cos + rim));
    float horizon = across / (far * far * (whole + rim));
#endif
    float shift = min(max(slight - rim, 0.0), deep - rim);
    float height = (edge - shift) / (horizon - shift);
#ifdef TERM_VEIL
#ifdef INSIDE
    float begin = -far * fields.nadir_cos, reach = far * whole;
#else
    float begin = fields.begin, reach = sqrt(across);
#endif
    if (fields.planet > 0.0) height = (fields.end - begin) / reach;
#endif
    height = clamp(height, -1.0, 1.0);
    float sun = max(fields.end_sun_cos + stretch, 0.0);
    float brightness = clamp(sun + max(near + stretch, 0.0) * fields.eye_sun_cos, 0.0, 1.0);
    float place = brightness * clamp(fields.eye_sun_cos + 1.0 + stretch, 0.0, 1.0);
    return vec4(height, height - min(deep + sun * deep, 0.0), brightness, place);
}

#ifdef TERM_TABLE
const int BRIGHTNESSES = 8, HEIGHTS = 4;

vec4 node(int brightness, int height) {
    int k = brightness * HEIGHTS + height;
    if (k == BRIGHTNESSES * HEIGHTS - 1) return vec4(1.0);
    return vec4(red[k], green[k], blue[k], cover[k]);
}

// Linear between nodes: texture filters have weights of 8 bits.
vec4 table_at(float place, float height) {
    float x = clamp(place, 0.0, 1.0) * float(BRIGHTNESSES - 1);
    float y = clamp(height, 0.0, 1.0) * float(HEIGHTS - 1);
    int i = min(int(x), BRIGHTNESSES - 2), j = min(int(y), HEIGHTS - 2);
    x -= float(i);
    y -= float(j);
    return (node(i, j) * (1.0 - x) + node(i + 1, j) * x) * (1.0 - y) +
        (node(i, j + 1) * (1.0 - x) + node(i + 1, j + 1) * x) * y;
}
#endif

vec3 air(Fields fields, inout float alpha, inout vec3 transmittance) {
    vec4 at = sky(fields);
    float amount = max(at.y, 0.0) * at.z;
#ifndef TERM_VEIL
    if (fields.planet > 0.0) amount = 0.0;
#endif
    vec4 flat_ = vec4(fields.color * tint, opacity), color = flat_ * (1.0 + at.x);
#ifdef TERM_TABLE
    color *= table_at(at.w, at.x);
#endif
#ifdef TERM_MIE
    vec4 glow = flat_;
#ifdef TERM_TABLE
    glow *= table_at(min(at.w, 0.5), 1.0);
#endif
    float turned = fields.sun_cos;
#ifdef TERM_LAMP
    float far = light_distance * fields.radius;
    float place = length(vec2(fields.end, fields.impact));
    float between = far * far + place * place - 2.0 * far * place * fields.end_sun_cos;
    turned = (far * fields.sun_cos - fields.end) / sqrt(between > 0.0 ? between : 1.0);
    turned = clamp(turned, -1.0, 1.0);
#endif
    color += glow * cheap_cornette_shanks(turned, -asymmetry);
#endif
    vec4 sent = 1.0 - exp(-falloff * amount * color);
    alpha = sent.a;
    return sent.rgb;
}
