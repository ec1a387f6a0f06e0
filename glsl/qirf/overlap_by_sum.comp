// The overlaps of qirf/overlap.comp by the determinant and adjugate of the sum of the two covariances, as the formula
// is usually written. Only the sweep runs it, to measure the cost of forming the sum.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"

#include "lib/overlap_walk.glsl"

// A constant instead of 0 / 0, whose bits differ between drivers.
float not_a_number() { return uintBitsToFloat(0x7fc00000); }

// Adds the covariance of axes of scale s: xx, xy, xz; yy, yz, zz.
void add_covariance(Axes a, vec3 s, inout vec3 row_x, inout vec3 rest) {
    [[unroll]] for (uint k = 0; k < 3; k++) {
        vec3 m = a.rotation[k] * s[k];
        row_x += m.x * m;
        rest += vec3(m.y * m.y, m.y * m.z, m.z * m.z);
    }
}

float by_sum(Axes x, Axes y) {
    vec3 row = vec3(0), rest = vec3(0);
    // The determinant is taken in world units, as usual.
    vec3 sx = x.scale * power_of_two(max(x.exponent, LEAST_EXPONENT));
    vec3 sy = y.scale * power_of_two(max(y.exponent, LEAST_EXPONENT));
    add_covariance(x, sx, row, rest);
    add_covariance(y, sy, row, rest);
    vec3 d = x.mean - y.mean;
    float root = sqrt(8 * product(sx)) * sqrt(product(sy));
    vec3 c0 = vec3(rest.x * rest.z - rest.y * rest.y, row.z * rest.y - row.y * rest.z, row.y * rest.y - row.z * rest.x);
    vec3 c1 = vec3(row.x * rest.z - row.z * row.z, row.y * row.z - row.x * rest.y, row.x * rest.x - row.y * row.y);
    float det = dot(row, c0);
    if (nan(det) || det <= 0) return not_a_number();
    float e = d.x * d.x * c0.x + d.y * d.y * c1.x + d.z * d.z * c1.z + 2 * (d.x * d.y * c0.y + d.x * d.z * c0.z + d.y * d.z * c1.y);
    return root / sqrt(det) * exp(-0.5 * e / det);
}

float overlap(Axes x, Axes y) {
    // A failure stays visible as NaN.
    float n = by_sum(x, y);
    return nan(n) ? not_a_number() : min(n, 1.0);
}
