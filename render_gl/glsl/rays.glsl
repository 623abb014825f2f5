// Each pixel's ray and what it meets, exactly: twins of pixel_slopes, ray_offsets, ray_sphere and
// ray_cone in model_jax (_view, _intersect; the formulas and why they are stable are told there).
// A ray is m + t d, d = (x, y, 1), t eye depth relative to a body's centre, m in the image-parallel
// plane through it; lengths in planet radii. Define: CONE for a shadow, else a sphere is met.

uniform float pixel_size;  // side of a pixel at eye depth 1
uniform vec2 principal;    // where the camera's axis goes through the picture, pixels from below
uniform float first_row;   // row of the picture, from below, that the render target begins with
uniform vec2 anchor;       // pixel, likewise, at which m is aim.yz
uniform vec3 aim;          // change of m per pixel, m at the anchor
uniform vec3 body_center;  // as the camera sees it

vec2 picture_position() {
    return gl_FragCoord.xy + vec2(0.0, first_row);
}

vec2 ray_direction() {
    return pixel_size * (picture_position() - principal);
}

vec2 ray_offset() {
    return aim.x * (picture_position() - anchor) + aim.yz;
}

#ifdef CONE
uniform float unbounded;     // stands for infinity: its square still exists
uniform float quotients;     // quotients from here on are refused
uniform mat3 cone_axes;      // columns e1, e2 and the direction toward the sun, eye axes
uniform float cone_tangent;  // tan of the sun's angular radius
uniform vec3 cone_center;    // the axis' point nearest to the planet's centre
uniform vec2 cone_shape;     // radius there; where the body lies along the axis

float quotient(float numerator, float denominator, float otherwise) {
    bool usable = denominator != 0.0 && abs(numerator) < quotients * abs(denominator);
    return usable ? numerator / denominator : otherwise;
}

// The t with intercept + rate t <= 0.
vec2 half_line(float intercept, float rate) {
    if (abs(intercept) >= quotients * abs(rate))
        return intercept > 0.0 ? vec2(unbounded, -unbounded) : vec2(-unbounded, unbounded);
    float edge = quotient(-intercept, rate, 0.0);
    return vec2(rate < 0.0 ? edge : -unbounded, rate > 0.0 ? edge : unbounded);
}

// Where a ray runs inside the umbra: enter, leave; enter > leave where it stays outside.
vec2 ray_cone(vec2 d, vec2 m) {
    vec3 p = (vec3(m, 0.0) - cone_center) * cone_axes;
    vec3 v = vec3(d, 1.0) * cone_axes;
    float k = cone_tangent;
    float rho = cone_shape.x + k * p.z;
    float a = dot(v.xy, v.xy) - k * v.z * (k * v.z);
    float b = dot(p.xy, v.xy) - k * v.z * rho;
    float c = dot(p.xy, p.xy) - rho * rho;
    float size = length(rho * v.xy - k * v.z * p.xy);
    float turn = abs(p.x * v.y - p.y * v.x);
    float discriminant = (size - turn) * (size + turn);
    float side = b < 0.0 ? -1.0 : 1.0;
    float q = -(b + side * sqrt(max(discriminant, 0.0)));
    float first = quotient(q, a, a < 0.0 ? side * unbounded : -side * unbounded);
    float second = quotient(c, q, 0.0);
    vec2 ends = vec2(min(first, second), max(first, second));
    bool parallel = a == 0.0 && b == 0.0;
    if (parallel) ends = vec2(-unbounded, c <= 0.0 ? unbounded : -2.0 * unbounded);
    if (a < 0.0) ends = v.z > 0.0 ? vec2(ends.y, unbounded) : vec2(-unbounded, ends.x);
    else if (discriminant <= 0.0 && !parallel) ends = vec2(unbounded, -unbounded);
    vec2 slab = half_line(p.z - cone_shape.y, v.z), nappe = half_line(-rho, -k * v.z);
    return vec2(max(ends.x, max(slab.x, nappe.x)), min(ends.y, min(slab.y, nappe.y)));
}
#else
uniform float body_radius;

// Where a ray meets the sphere; a line that misses it gets its closest approach twice.
vec2 ray_sphere(vec2 d, vec2 m, out bool hit) {
    float dd = 1.0 + dot(d, d);
    float turn = m.x * d.y - m.y * d.x;
    float discriminant = body_radius * body_radius - (dot(m, m) + turn * turn) / dd;
    hit = discriminant > 0.0;
    float closest = -dot(m, d) / dd;
    float reach = sqrt(max(discriminant, 0.0) / dd);
    return vec2(closest - reach, closest + reach);
}

// Whether a sphere that the ray's line cuts lies before the camera, which is outside of it.
bool is_ahead(vec2 d) {
    return dot(vec3(d, 1.0), body_center) > 0.0;
}
#endif
