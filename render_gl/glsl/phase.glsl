// How scattered light is spread over directions. Twins, with the formulas: rayleigh and
// henyey_greenstein in model_jax._phase, which owns the number.

#ifdef FIELD_SUN_COS
uniform float phase_nearest;

float rayleigh(float cosine) {
    return 0.75 * (1.0 + cosine * cosine);
}

float henyey_greenstein(float cosine, float asymmetry) {
    float size = abs(asymmetry), turned = asymmetry < 0.0 ? 1.0 + cosine : 1.0 - cosine;
    float squared =
        max((1.0 - size) * (1.0 - size) + 2.0 * size * max(turned, 0.0), phase_nearest);
    return (1.0 - size) * (1.0 + size) / (squared * sqrt(squared));
}
#endif
