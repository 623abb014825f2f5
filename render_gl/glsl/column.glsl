// Columns of air that thins out with height, and what they do to light, for any look that asks for
// the fields they take. Twins, with the formulas: column, mean_transmittance and pieces in
// model_jax._column, which owns the numbers.

#ifdef FIELD_IMPACT
uniform float column_nodes[6];
uniform float column_shares[6];
uniform vec4 column_limits;  // reach, least and deepest scale heights, what divides at least

// How a piece rises between two distances from the ray's nearest point, on one side of it.
void rise_of(float near, float far, float altitude, float impact, float scale_height, out float low,
             out float height, out float begin, out float span) {
    float smallest = column_limits.w;
    float first = sqrt(impact * impact + near * near), last = sqrt(impact * impact + far * far);
    height = max(scale_height, column_limits.y * (first + impact));
    begin = near / sqrt(max(height * (first + impact), smallest));
    float end = far / sqrt(max(height * (last + impact), smallest));
    float beyond = (far - near) * ((far + near) / max(first + last, smallest)) / height;
    span = min(beyond / max(begin + end, smallest),
        column_limits.x / (sqrt(begin * begin + column_limits.x) + begin));
    low = altitude + near * (near / max(first + impact, smallest));
}

// Height, and distance from the planet's centre, at a length from a ray's nearest point.
vec2 place_at(float along, float altitude, float impact) {
    float distance = sqrt(impact * impact + along * along);
    return vec2(altitude + along * (along / max(distance + impact, column_limits.w)), distance);
}

// The density's integral along it.
float column(float near, float far, float altitude, float impact, float scale_height) {
    float low, height, begin, span, smallest = column_limits.w, total = 0.0;
    rise_of(near, far, altitude, impact, scale_height, low, height, begin, span);
    for (int k = 0; k < 6; k++) {
        float shift = column_nodes[k] * span;
        float t = begin + shift;
        float rise = height * t * t;
        total += column_shares[k] * exp(-shift * (t + begin)) * (impact + rise) /
            sqrt(max(2.0 * impact + rise, smallest));
    }
    return 2.0 * sqrt(height) * exp(min(-low / height, column_limits.z)) * span * total;
}

#ifdef SHADOWS
#define PIECES 4
#else
#define PIECES 2
#endif

// A ray's air as pieces, each on one side of its nearest point and wholly lit or dark: where they are
// cut, and which are dark.
void pieces(vec2 air, vec2 dark, out float cuts[PIECES + 1], out bool in_shadow[PIECES]) {
    float middle = clamp(0.0, air.x, air.y);
#ifdef SHADOWS
    float between = clamp(middle, dark.x, dark.y);
    cuts = float[](air.x, min(dark.x, middle), between, max(dark.y, middle), air.y);
    in_shadow = bool[](false, middle > dark.x, middle < dark.y, false);
#else
    cuts = float[](air.x, middle, air.y);
    in_shadow = bool[](false, false);
#endif
}
#endif

#ifdef TRANSMITS
uniform float series_depth;

// (1 - exp(-depth)) / depth.
vec3 mean_transmittance(vec3 depth) {
    vec3 found;
    for (int c = 0; c < 3; c++) {
        float series = 1.0;
        for (int k = 10; k > 1; k--) series = 1.0 - depth[c] / float(k) * series;
        found[c] = depth[c] < series_depth ? series : (1.0 - exp(-depth[c])) / depth[c];
    }
    return found;
}
#endif
