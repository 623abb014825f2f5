#version 330
// Pass 5: reads the depths of its pixel, hands on its own and the one behind, and asks the look for
// the light of what lies between them. EXACT: its own is where the pixel's ray enters the shell; else
// the mesh's. FIELD_...: what the look asks for, PLACES: heights and
// lengths among it, TOWARD_SUN: where the sun is, EYE: where the camera is; TRANSMITS: it has a transmittance.

#include "rays.glsl"
#include "fields.glsl"
#include "depth_code.glsl"
#include "column.glsl"
#include "sunlight.glsl"
#include "phase.glsl"

// What the pixel's ray meets, as model_jax.FIELDS says.
struct Fields {
    vec3 color;  // linear rgb of the air
#ifdef FIELD_WIDTH
    float width;
#endif
#ifdef FIELD_LIT
    float lit;
#endif
#ifdef FIELD_DARK
    float dark;
#endif
#ifdef FIELD_PLANET
    float planet;
#endif
#ifdef FIELD_WATER
    float water;
#endif
#ifdef FIELD_BEGIN
    float begin;
#endif
#ifdef FIELD_END
    float end;
#endif
#ifdef FIELD_DARK_BEGIN
    float dark_begin;
#endif
#ifdef FIELD_DARK_END
    float dark_end;
#endif
#ifdef FIELD_ALTITUDE
    float altitude;
#endif
#ifdef FIELD_IMPACT
    float impact;
#endif
#ifdef FIELD_PER_LENGTH
    float per_length;
#endif
#ifdef FIELD_SUNWARD
    float sunward;
#endif
#ifdef FIELD_SUN_COS
    float sun_cos;
#endif
#ifdef FIELD_BEGIN_SUN_COS
    float begin_sun_cos;
#endif
#ifdef FIELD_END_SUN_COS
    float end_sun_cos;
#endif
#ifdef FIELD_SHELL
    float shell;
#endif
#ifdef FIELD_NADIR_COS
    float nadir_cos;
#endif
#ifdef FIELD_RADIUS
    float radius;
#endif
#ifdef FIELD_EYE_HEIGHT
    float eye_height;
#endif
#ifdef FIELD_GROUND_HORIZON
    float ground_horizon;
#endif
#ifdef FIELD_SHELL_HORIZON
    float shell_horizon;
#endif
#ifdef FIELD_EYE_SUN_COS
    float eye_sun_cos;
#endif
};

// vec3 air(Fields, inout float alpha, inout vec3 transmittance): light of the air; alpha comes as the
// colour's, transmittance as 1.
#include "look"

uniform vec4 color;                   // the air's: linear rgb, and alpha
#ifdef TOWARD_SUN
uniform vec3 sun_in_view;             // unit vector toward the sun, eye axes
#endif
#ifdef FIELD_SHELL
uniform float shell_height;           // scene length units
#endif
#ifdef FIELD_NADIR_COS
uniform vec3 straight_down;           // unit vector to the planet's centre, eye axes
#endif
#ifdef EYE
uniform float eye_height;             // scene length units
uniform vec2 eye_horizons;            // of ground and shell: cosines with straight down
uniform float eye_sun_cos;
#endif
#ifdef FIELD_PLANET
uniform sampler2D ground_pass;            // pass 3: coverage in alpha
#endif

#ifdef FIELD_WATER
#ifdef WATER
uniform sampler2D water_pass;             // pass 3: how much of the ground mirrors
#endif
#endif

uniform sampler2D planet_atmosphere;  // PlAtDepth of the paper
#ifdef SHADOWS
uniform sampler2D shadow_depths;      // front and back of each shadow, one above the other
uniform int band_rows;
#endif
#ifndef EXACT
in float mesh_depth;
#endif

layout(location = 0) out vec4 combined;
layout(location = 1) out float front;
layout(location = 2) out float back;
#ifdef TRANSMITS
layout(location = 3) out vec4 passed;
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
#ifdef EXACT
    bool hit;
    front = coded_depth(ray_sphere(ray_direction(), ray_offset(), hit).x);
    if (!hit) discard;
#else
    front = coded_depth(mesh_depth);
#endif
    back = texelFetch(planet_atmosphere, pixel, 0).r;
    // Ground that rises out of the air, or a body before it, hides it.
    if (!is_nearer(front, back)) discard;
    float depths[DEPTHS];
    depths[0] = front;
    depths[1] = back;
#ifdef SHADOWS
    for (int k = 0; k < 2 * SHADOWS; k++)
        depths[2 + k] = texelFetch(shadow_depths, pixel + ivec2(0, k * band_rows), 0).r;
#ifndef EXACT
    // On a mesh's outline a back may be drawn where its front is not: that is no shadow.
    for (int k = 2; k < DEPTHS; k += 2)
        if (is_nearer(depths[k + 1], depths[k])) depths[k] = depths[k + 1];
#endif
#endif
#ifdef STRETCH
    float stretch = length(vec3(ray_direction(), 1.0));
#else
    float stretch = 1.0;
#endif
    Fields fields;
    fields.color = color.rgb;
#ifdef FIELD_WIDTH
    fields.width = (eye_depth(back) - eye_depth(front)) * stretch / width_unit;
#endif
#ifdef FIELD_LIT
    fields.lit = layer_widths(depths, stretch).x;
#endif
#ifdef FIELD_DARK
    fields.dark = layer_widths(depths, stretch).y;
#endif
#ifdef FIELD_PLANET
    fields.planet = texelFetch(ground_pass, pixel, 0).a;
#endif
#ifdef FIELD_WATER
    fields.water = 0.0;
#ifdef WATER
    fields.water = texelFetch(water_pass, pixel, 0).r;
#endif
#endif
#ifdef PLACES
    vec2 d = ray_direction(), m = ray_offset();
    float dd = 1.0 + dot(d, d), turn = m.x * d.y - m.y * d.x;
    float slant = sqrt(dd), squared = (dot(m, m) + turn * turn) / dd, impact = sqrt(squared);
#ifdef LINEAR
    float nearest = -length_unit * dot(m, d) / dd;
#else
    float nearest = length_unit * (eye_reference.x - dot(m, d) / dd);
#endif
#endif
#ifdef FIELD_BEGIN
    fields.begin = (eye_depth(front) - nearest) * slant;
#endif
#ifdef FIELD_END
    fields.end = (eye_depth(back) - nearest) * slant;
#endif
#ifdef FIELD_DARK_BEGIN
    fields.dark_begin = 0.0;
#ifdef SHADOWS
    fields.dark_begin = (eye_depth(NEARER(FARTHER(depths[2], front), back)) - nearest) * slant;
#endif
#endif
#ifdef FIELD_DARK_END
    fields.dark_end = 0.0;
#ifdef SHADOWS
    fields.dark_end = (eye_depth(NEARER(FARTHER(depths[3], front), back)) - nearest) * slant;
#endif
#endif
#ifdef FIELD_ALTITUDE
    fields.altitude = (squared - 1.0) / (impact + 1.0) * length_unit;
#endif
#ifdef FIELD_IMPACT
    fields.impact = impact * length_unit;
#endif
#ifdef FIELD_PER_LENGTH
#ifdef STRETCH
    fields.per_length = 1.0 / width_unit;
#else
    fields.per_length = 1.0 / (width_unit * slant);
#endif
#endif
#ifdef TOWARD_SUN
    float towards = dot(vec3(d, 1.0), sun_in_view);
    float sunward = (dot(m, sun_in_view.xy) - dot(m, d) / dd * towards) * length_unit;
#endif
#ifdef FIELD_SUNWARD
    fields.sunward = sunward;
#endif
#ifdef FIELD_BEGIN_SUN_COS
    float begin = (eye_depth(front) - nearest) * slant;
    fields.begin_sun_cos = (sunward + begin * (towards / slant)) /
        length(vec2(impact * length_unit, begin));
#endif
#ifdef FIELD_END_SUN_COS
    float end = (eye_depth(back) - nearest) * slant;
    fields.end_sun_cos = (sunward + end * (towards / slant)) /
        length(vec2(impact * length_unit, end));
#endif
#ifdef FIELD_SUN_COS
    fields.sun_cos = towards / slant;
#endif
#ifdef FIELD_SHELL
    fields.shell = shell_height;
#endif
#ifdef FIELD_NADIR_COS
    fields.nadir_cos = dot(vec3(d, 1.0), straight_down) / slant;
#endif
#ifdef FIELD_RADIUS
    fields.radius = length_unit;
#endif
#ifdef FIELD_EYE_HEIGHT
    fields.eye_height = eye_height;
#endif
#ifdef FIELD_GROUND_HORIZON
    fields.ground_horizon = eye_horizons.x;
#endif
#ifdef FIELD_SHELL_HORIZON
    fields.shell_horizon = eye_horizons.y;
#endif
#ifdef FIELD_EYE_SUN_COS
    fields.eye_sun_cos = eye_sun_cos;
#endif
    float alpha = color.a;
    vec3 transmittance = vec3(1.0);
    vec3 light = air(fields, alpha, transmittance);
    combined = vec4(light, alpha);
#ifdef TRANSMITS
    passed = vec4(transmittance, 1.0);
#endif
}
