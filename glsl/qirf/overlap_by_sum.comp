// The overlaps of qirf/overlap.comp by the sum of the two covariances, as the formula is usually written. Only the sweep runs
// it, to show what forming the sum costs.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"

/// Method: Cholesky factor of the sum.
const uint CHOLESKY = 0;
/// Method: determinant and adjugate of the sum.
const uint DETERMINANT = 1;

layout(constant_id = 3) const uint METHOD = CHOLESKY;

#include "lib/overlap_walk.glsl"

// Not from 0 / 0, whose bits differ between drivers.
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
    // The determinant is taken in world units, as it usually is.
    int exponent = METHOD == CHOLESKY ? max(x.exponent, y.exponent) : 0;
    vec3 sx = x.scale * power_of_two(max(x.exponent - exponent, LEAST_EXPONENT));
    vec3 sy = y.scale * power_of_two(max(y.exponent - exponent, LEAST_EXPONENT));
    add_covariance(x, sx, row, rest);
    add_covariance(y, sy, row, rest);
    vec3 d = (x.mean - y.mean) * power_of_two(-exponent);
    float root = sqrt(8 * product(sx)) * sqrt(product(sy));
    if (METHOD == CHOLESKY) {
        float l00 = sqrt(row.x), l10 = row.y / l00, l20 = row.z / l00;
        float p11 = rest.x - l10 * l10;
        float l11 = sqrt(p11), l21 = (rest.y - l20 * l10) / l11;
        float p22 = rest.z - l20 * l20 - l21 * l21;
        float l22 = sqrt(p22);
        // Where an earlier one is not a number, p22 is none.
        if (nan(p22) || row.x <= 0 || p11 <= 0 || p22 <= 0) return not_a_number();
        float z0 = d.x / l00, z1 = (d.y - l10 * z0) / l11, z2 = (d.z - l20 * z0 - l21 * z1) / l22;
        return root / (l00 * l11 * l22) * exp(-0.5 * (z0 * z0 + z1 * z1 + z2 * z2));
    }
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
