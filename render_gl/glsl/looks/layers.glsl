// The look `layers`: the paper's air, bright by its width. Twin: LayersLook.air in model_jax.

uniform float brightness;
uniform vec3 shadow;  // light of shadowed air as a share of lit air, per channel
uniform vec3 tint;    // factor per channel on the air's colour

vec3 air(Fields fields, inout float alpha, inout vec3 transmittance) {
    vec3 light = fields.color * tint * (fields.lit + shadow * fields.dark);
    return brightness * light;
}
