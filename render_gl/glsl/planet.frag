#version 330
// Pass 3: Lambert-lit albedo, and coverage 1 in alpha. EXACT: the pixel's ray meets the ground, of
// which the mesh only bounds the pixels. COLOR_DEPTH adds the depth; ALBEDO, RELIEF and SUN say what
// the scene has, TEXTURE that the albedo is no one colour, OCCLUDERS how many. Without a sun, or
// for a look that lights the ground itself (UNLIT), the albedo is shown as it is. WATER: the location at
// which how much of the ground mirrors is written.

#include "sphere_map.glsl"
#ifdef EXACT
#include "rays.glsl"
uniform mat3 basis;  // world -> eye axes
#else
in vec3 direction;
in float mesh_depth;
#endif
#include "depth_code.glsl"

layout(location = 0) out vec4 surface;
#ifdef COLOR_DEPTH
layout(location = 1) out float depth;
#endif
#ifdef WATER
layout(location = WATER) out float mirrors;
uniform sampler2D water;
#endif

vec4 of_map(sampler2D map, vec3 at) {
    vec2 uv = map_position(at);
    // Across the date line u jumps by one; without the correction the whole map would be averaged.
    vec2 dx = dFdx(uv), dy = dFdy(uv);
    dx.x -= round(dx.x);
    dy.x -= round(dy.x);
    return textureGrad(map, uv, dx, dy);
}

#ifdef ALBEDO
#ifdef TEXTURE
uniform sampler2D albedo;

vec3 surface_albedo(vec3 at) {
    return of_map(albedo, at).rgb;
}
#else
uniform vec3 planet_color;

vec3 surface_albedo(vec3 at) {
    return planet_color;
}
#endif
#endif

#ifdef SUN
uniform vec3 sun;  // unit vector toward the sun, world axes
#ifdef RELIEF
uniform sampler2D relief;
uniform float relief_scale;

// Normal of the displaced sphere by central differences of the height map along two tangents.
vec3 surface_normal(vec3 at) {
    float step_angle = PI / float(textureSize(relief, 0).y);
    vec3 east = normalize(abs(at.z) < 0.999 ? vec3(-at.y, at.x, 0.0) : vec3(0.0, 1.0, 0.0));
    vec3 north = cross(at, east);
    vec2 rise;
    for (int axis = 0; axis < 2; axis++) {
        vec3 side = step_angle * (axis == 0 ? east : north);
        rise[axis] = textureLod(relief, map_position(normalize(at + side)), 0.0).r
                   - textureLod(relief, map_position(normalize(at - side)), 0.0).r;
    }
    rise *= relief_scale / (2.0 * step_angle);
    return normalize(at - rise.x * east - rise.y * north);
}
#else
vec3 surface_normal(vec3 at) {
    return at;
}
#endif
#endif

#ifdef OCCLUDERS
uniform vec4 occluders[OCCLUDERS];  // centre and radius, world axes, planet radii
uniform float sun_tangent;          // tan of the sun's angular radius

// Whether ground lies in an occluder's umbra, the cone that pass 1 and 2 draw.
bool eclipsed(vec3 ground) {
    for (int k = 0; k < OCCLUDERS; k++) {
        vec3 offset = ground - occluders[k].xyz;
        float along = dot(offset, sun);
        float across = length(offset - along * sun);
        if (along < 0.0 && across < occluders[k].w + sun_tangent * along) return true;
    }
    return false;
}
#endif

void main() {
#ifdef EXACT
    bool hit;
    vec2 d = ray_direction(), m = ray_offset();
    float met = ray_sphere(d, m, hit).x;
    vec3 at = normalize(vec3(m + met * d, met) * basis);
#else
    float met = mesh_depth;
    vec3 at = normalize(direction);
#endif
    vec3 light = vec3(0.0);
#ifdef ALBEDO
    light = surface_albedo(at);
#ifdef SUN
#ifndef UNLIT
    light *= max(dot(surface_normal(at), sun), 0.0);
#ifdef OCCLUDERS
    if (eclipsed(at)) light = vec3(0.0);
#endif
#endif
#endif
#endif
    surface = vec4(light, 1.0);
#ifdef WATER
    mirrors = of_map(water, at).r;
#endif
#ifdef EXACT
    // Only now: the texture's derivatives need the pixels beside the limb.
    if (!hit || !is_ahead(d)) discard;
#ifndef COLOR_DEPTH
    gl_FragDepth = coded_depth(met);
#endif
#endif
#ifdef COLOR_DEPTH
    depth = coded_depth(met);
#ifdef SORTED
    gl_FragDepth = sorting_depth(met);
#endif
#endif
}
