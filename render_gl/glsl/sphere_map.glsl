// Equirectangular maps: longitude -180..180 degrees from left to right, north (+z) on top.

const float PI = 3.14159265358979;

vec2 map_position(vec3 direction) {
    float longitude = atan(direction.y, direction.x);
    float latitude = asin(clamp(direction.z, -1.0, 1.0));
    return vec2(longitude / (2.0 * PI) + 0.5, 0.5 - latitude / PI);
}
