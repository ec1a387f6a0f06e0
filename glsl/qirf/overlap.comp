// Normalised overlaps (Q4) N_ij = S_ij / sqrt(S_ii S_jj) of all pairs of a block, by QR. lib/overlap_walk.glsl walks the pairs.
//
// In the frame of the flatter Gaussian A, the 6x3 matrix [diag(s_A); diag(s_B) R_B^T R_A] has the triangle R of its QR
// factorisation with R^T R = S_A + S_B. The diagonal of R gives the determinant, and the solution of R^T z = R_A^T (p_A - p_B)
// the exponent. The diagonal block on top makes each Householder vector four long, and bounds |R_kk| >= s_A,k: nothing
// cancels, and nothing under a root is negative, however thin the discs.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/overlap_walk.glsl"

float by_qr(Axes x, Axes y) {
    bool first = x.scale.z * y.scale.x <= y.scale.z * x.scale.x; // x is the flatter
    int exponent = max(x.exponent, y.exponent);
    float fx = power_of_two(max(x.exponent - exponent, LEAST_EXPONENT));
    float fy = power_of_two(max(y.exponent - exponent, LEAST_EXPONENT));
    float f = fx * fy;
    mat3 ra = first ? x.rotation : y.rotation, rb = first ? y.rotation : x.rotation;
    vec3 a = first ? x.scale * fx : y.scale * fy;
    vec3 b = first ? y.scale * fy : x.scale * fx;
    vec3 p = (x.mean - y.mean) * power_of_two(-exponent); // N does not depend on its sign

    // Columns of diag(b) R_B^T R_A.
    vec3 b0 = b * (ra[0] * rb), b1 = b * (ra[1] * rb), b2 = b * (ra[2] * rb);
    float n0 = sqrt(a.x * a.x + dot(b0, b0));
    float d01 = dot(b0, b1) / n0, d02 = dot(b0, b2) / n0;
    b1 -= b0 * (d01 / (n0 + a.x));
    b2 -= b0 * (d02 / (n0 + a.x));
    float n1 = sqrt(a.y * a.y + dot(b1, b1));
    float d12 = dot(b1, b2) / n1;
    b2 -= b1 * (d12 / (n1 + a.y));
    float n2 = sqrt(a.z * a.z + dot(b2, b2));

    vec3 q = p * ra;
    float z0 = q.x / n0;
    float z1 = (q.y - d01 * z0) / n1;
    float z2 = (q.z - d02 * z0 - d12 * z1) / n2;
    // Ratios instead of a sum of logarithms, which would cancel.
    float root = sqrt(8 * product(x.scale)) * sqrt(product(y.scale)) * (f * sqrt(f));
    return root / (n0 * n1 * n2) * exp(-0.5 * (z0 * z0 + z1 * z1 + z2 * z2));
}

float overlap(Axes x, Axes y) {
    // A Gaussian with a NaN mean overlaps with nothing.
    float n = by_qr(x, y);
    return finite(n) ? min(n, 1.0) : 0;
}
