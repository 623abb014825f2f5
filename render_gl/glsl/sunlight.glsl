// Sunlight on its way through air that thins out, and how much of it a ray meets. Twins, with the
// formulas: model_jax._sun_column and _sunlight, which own the numbers.

#ifdef FIELD_SUNWARD
uniform float sun_nodes[8];
uniform float sun_shares[8];
uniform float sun_within[64];
uniform float tail_factors[6];
uniform float on_ground;   // share of the shell's height below which a ray ends there
uniform vec4 sun_limits;  // rate of scaled_tail, mean heights low and high, deepest scale heights

float scaled_tail(float t) {
    float w = 1.0 / (1.0 + sun_limits.x * t), found = tail_factors[5];
    for (int k = 4; k >= 0; k--) found = tail_factors[k] + w * found;
    return w * found;
}

float outward(float sunward, float distance, float height, float density, float at_top, float top,
              float scale_height) {
    float smallest = column_limits.w;
    float steep = sunward * sunward / max(2.0 * distance * scale_height, smallest);
    float mean = sun_limits.y + (sun_limits.z - sun_limits.y) * steep / (1.0 + steep);
    float room = max(top - height, 0.0) / scale_height;
    float left = 1.0 / (1.0 + room / (8.0 * mean));
    for (int k = 0; k < 3; k++) left *= left;
    float size = sqrt((2.0 * distance + mean * scale_height * (1.0 - left)) * scale_height);
    float begin = sunward / max(size, smallest), end = sqrt(begin * begin + room);
    return size * max(density * scaled_tail(begin) - at_top * scaled_tail(end), 0.0);
}

// Column between a point and the sun.
float sun_column(float sunward, float distance, float height, float density, float top,
                 float scale_height) {
    float at_top = exp(-top / scale_height);
    float above = outward(abs(sunward), distance, height, density, at_top, top, scale_height);
    if (sunward >= 0.0) return above;
    float lowest = sqrt(max((distance - sunward) * (distance + sunward), 0.0));
    float low = height - sunward * (sunward / max(distance + lowest, column_limits.w));
    float least = exp(min(-low / scale_height, sun_limits.w));
    return max(2.0 * outward(0.0, lowest, low, least, at_top, top, scale_height) - above, 0.0);
}

// The same where the density is not known.
float sun_column_at(float sunward, float distance, float height, float top, float scale_height) {
    float least = max(scale_height, 2.0 * column_limits.y * distance);
    float density = exp(min(-height / least, sun_limits.w));
    return sun_column(sunward, distance, height, density, top, least);
}

#define NODES 8

// What a ray meets: its column, and shares of it that are sunlit and shaded, and the mean sine of the
// sun's elevation. extinction: of a unit of length, on the sun's way; dimming: on the way to the
// camera, the same or 0.
void sunlight_met(float cuts[PIECES + 1], bool in_shadow[PIECES], float altitude, float impact,
                  float scale_height, float sunward, float sun_cos, float top, float extinction,
                  float dimming, out float column, out vec3 shares) {
    float smallest = column_limits.w, depth = 0.0, offset = 0.0, weight = 0.0;
    column = 0.0;
    shares = vec3(0.0);
    for (int k = 0; k < PIECES; k++) {
        float near = min(abs(cuts[k]), abs(cuts[k + 1])), far = max(abs(cuts[k]), abs(cuts[k + 1]));
        if (near == far) continue;
        bool before = cuts[k] + cuts[k + 1] < 0.0;
        float low, height, begin, span;
        rise_of(near, far, altitude, impact, scale_height, low, height, begin, span);
        float dense = exp(min(-low / height, sun_limits.w));
        float size = 2.0 * sqrt(height) * dense * span;
        float parts[NODES], passes[NODES], elevations[NODES];
        float whole = 0.0;
        for (int n = 0; n < NODES; n++) {
            float shift = sun_nodes[n] * span, t = begin + shift, fall = shift * (t + begin);
            float above = height * t * t, thin = exp(-fall);
            float length = sqrt(max(2.0 * impact + above, smallest)), distance = impact + above;
            parts[n] = size * thin * distance / length;
            whole += sun_shares[n] * parts[n];
            float along = sqrt(height) * t * length;
            float sun = clamp(sunward + (before ? -along : along) * sun_cos, -distance, distance);
            float way = sun_column(sun, distance, low + height * fall, dense * thin, top, height);
            passes[n] = exp(-extinction * way);
            elevations[n] = max(sun, 0.0) / max(distance, smallest);
        }
        float deep[NODES];
        for (int n = 0; n < NODES; n++) {
            float inner = 0.0;
            for (int j = 0; j < NODES; j++) inner += sun_within[NODES * n + j] * parts[j];
            deep[n] = depth + dimming * (before ? whole - inner : inner);
        }
        if (weight == 0.0) offset = before ? deep[NODES - 1] : deep[0];
        for (int n = 0; n < NODES; n++) {
            float sent = sun_shares[n] * parts[n] * exp(offset - deep[n]);
            weight += sent;
            shares += sent * vec3(in_shadow[k] ? 0.0 : passes[n], in_shadow[k] ? 1.0 : 0.0,
                elevations[n]);
        }
        column += whole;
        depth += dimming * whole;
    }
    shares /= max(weight, smallest);
}
#endif
