// How scattered light is spread over directions. Twins, with the formulas: rayleigh,
// henyey_greenstein and cheap_cornette_shanks in model_jax._phase, which owns the number.

#ifdef FIELD_SUN_COS
uniform float phase_nearest;

float rayleigh(float cosine) {
    return 0.75 * (1.0 + cosine * cosine);
}

// 1 + g^2 - 2 g cos.
float squared_distance(float cosine, float asymmetry) {
    float size = abs(asymmetry), turned = asymmetry < 0.0 ? 1.0 + cosine : 1.0 - cosine;
    return max((1.0 - size) * (1.0 - size) + 2.0 * size * max(turned, 0.0), phase_nearest);
}

float henyey_greenstein(float cosine, float asymmetry) {
    float size = abs(asymmetry), squared = squared_distance(cosine, asymmetry);
    return (1.0 - size) * (1.0 + size) / (squared * sqrt(squared));
}

float cheap_cornette_shanks(float cosine, float asymmetry) {
    float size = abs(asymmetry);
    float height = 1.5 * (1.0 - size) * (1.0 + size) / (2.0 + size * size);
    return height * (1.0 + cosine * cosine) / squared_distance(cosine, asymmetry);
}
#endif
