// Normalised overlaps N_ij = S_ij / sqrt(S_ii S_jj) of all pairs of a block, one workgroup a tile of SUBGROUP rows by COLUMNS
// columns of its lower triangle. Lanes own rows; columns go round by broadcast, so that a Gaussian is read once a tile.
//
// In the frame of the flatter Gaussian, A, the 6x3 matrix [diag(s_A); diag(s_B) R_B^T R_A] has the triangle R of its QR
// factorisation with R^T R = S_A + S_B: its diagonal gives the determinant, R^T z = R_A^T (p_A - p_B) the exponent. The
// diagonal block on top makes each Householder vector four long, and bounds |R_kk| >= s_A,k: nothing cancels, nothing is
// negative under a root, however thin the discs.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/axes.glsl"

layout(constant_id = 2) const uint COLUMNS = 64; // a multiple of SUBGROUP
// 0 QR, 1 Cholesky factor of the sum, 2 determinant and adjugate of the sum: the last two show what they cost.
layout(constant_id = 3) const uint METHOD = 0;

layout(binding = 0, std430) readonly buffer Blocks { uvec4 blocks[]; }; // first member, m, offset in its batch's overlaps, -
layout(binding = 1, std430) readonly buffer Tiles { uvec2 tiles[]; };   // block, first row << 16 | first column
layout(binding = 2, std430) readonly buffer AxesRows { vec4 axes[]; };
// Lower triangles, column by column without gaps (LAPACK's packed "L"), block after block.
layout(binding = 3, std430) writeonly buffer Overlaps { float overlaps[]; };
layout(push_constant) uniform Push {
    uint first_tile;
    uint tile_count;
    uint first_member;
};

const int LEAST_EXPONENT = -100; // a Gaussian this much smaller has an overlap of 0 in effect

mat4 axes_row(uint n) { return mat4(axes[4 * n], axes[4 * n + 1], axes[4 * n + 2], axes[4 * n + 3]); }

// Not from 0 / 0: what drivers make of such is their own.
float not_a_number() { return uintBitsToFloat(0x7fc00000); }

float product(vec3 v) { return v.x * v.y * v.z; }

float by_qr(Axes x, Axes y) {
    bool first = x.scale.z * y.scale.x <= y.scale.z * x.scale.x; // x is the flatter
    int exponent = max(x.exponent, y.exponent);
    float fx = power_of_two(max(x.exponent - exponent, LEAST_EXPONENT));
    float fy = power_of_two(max(y.exponent - exponent, LEAST_EXPONENT));
    float f = fx * fy;
    mat3 ra = first ? x.rotation : y.rotation, rb = first ? y.rotation : x.rotation;
    vec3 a = first ? x.scale * fx : y.scale * fy;
    vec3 b = first ? y.scale * fy : x.scale * fx;
    vec3 p = (x.mean - y.mean) * power_of_two(-exponent); // N does not know its sign

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

// Covariance of axes of scale s: xx, xy, xz; yy, yz, zz.
void add_covariance(Axes a, vec3 s, inout vec3 row_x, inout vec3 rest) {
    [[unroll]] for (uint k = 0; k < 3; k++) {
        vec3 m = a.rotation[k] * s[k];
        row_x += m.x * m;
        rest += vec3(m.y * m.y, m.y * m.z, m.z * m.z);
    }
}

float by_sum(Axes x, Axes y) {
    vec3 row = vec3(0), rest = vec3(0);
    // The determinant is taken as it is usually written: in world units.
    int exponent = METHOD == 1 ? max(x.exponent, y.exponent) : 0;
    vec3 sx = x.scale * power_of_two(max(x.exponent - exponent, LEAST_EXPONENT));
    vec3 sy = y.scale * power_of_two(max(y.exponent - exponent, LEAST_EXPONENT));
    add_covariance(x, sx, row, rest);
    add_covariance(y, sy, row, rest);
    vec3 d = (x.mean - y.mean) * power_of_two(-exponent);
    float root = sqrt(8 * product(sx)) * sqrt(product(sy));
    if (METHOD == 1) {
        float l00 = sqrt(row.x), l10 = row.y / l00, l20 = row.z / l00;
        float p11 = rest.x - l10 * l10;
        float l11 = sqrt(p11), l21 = (rest.y - l20 * l10) / l11;
        float p22 = rest.z - l20 * l20 - l21 * l21;
        float l22 = sqrt(p22);
        if (!(row.x > 0 && p11 > 0 && p22 > 0)) return not_a_number();
        float z0 = d.x / l00, z1 = (d.y - l10 * z0) / l11, z2 = (d.z - l20 * z0 - l21 * z1) / l22;
        return root / (l00 * l11 * l22) * exp(-0.5 * (z0 * z0 + z1 * z1 + z2 * z2));
    }
    vec3 c0 = vec3(rest.x * rest.z - rest.y * rest.y, row.z * rest.y - row.y * rest.z, row.y * rest.y - row.z * rest.x);
    vec3 c1 = vec3(row.x * rest.z - row.z * row.z, row.y * row.z - row.x * rest.y, row.x * rest.x - row.y * row.y);
    float det = dot(row, c0);
    if (!(det > 0)) return not_a_number();
    float e = d.x * d.x * c0.x + d.y * d.y * c1.x + d.z * d.z * c1.z + 2 * (d.x * d.y * c0.y + d.x * d.z * c0.z + d.y * d.z * c1.y);
    return root / sqrt(det) * exp(-0.5 * e / det);
}

// Tests of bits: drivers may turn comparisons into minima that lose a NaN.
float overlap(Axes x, Axes y) {
    const uint INFINITY = 0x7f800000;
    if (METHOD == 0) {
        // What is no number (because a mean is none) overlaps with nothing.
        float n = by_qr(x, y);
        return floatBitsToUint(n) < INFINITY ? min(n, 1.0) : 0;
    }
    // Where the others fail, it stays visible.
    float n = by_sum(x, y);
    return (floatBitsToUint(n) & 0x7fffffff) > INFINITY ? not_a_number() : min(n, 1.0);
}

void main() {
    uint group = group_index();
    if (group >= tile_count) return;
    uvec2 tile = tiles[first_tile + group];
    uvec4 block = blocks[tile.x];
    uint m = block.y, base = block.x - first_member;
    uint lane = gl_SubgroupInvocationID;
    uint row = (tile.y >> 16) + lane;
    uint first_column = tile.y & 65535;
    Axes own = unpack_axes(axes_row(base + min(row, m - 1)));
    uint end = min(min(first_column + COLUMNS, (tile.y >> 16) + SUBGROUP), m);
    for (uint start = first_column; start < end; start += SUBGROUP) {
        mat4 round = axes_row(base + min(start + lane, m - 1));
        for (uint k = 0; k < SUBGROUP && start + k < end; k++) {
            uint column = start + k;
            mat4 other = mat4(subgroupBroadcast(round[0], k), subgroupBroadcast(round[1], k),
                              subgroupBroadcast(round[2], k), subgroupBroadcast(round[3], k));
            float n = column == row ? 1 : overlap(own, unpack_axes(other));
            if (column <= row && row < m) overlaps[block.z + column * (2 * m - column - 1) / 2 + row] = n;
        }
    }
}
