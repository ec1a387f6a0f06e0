// The low-rank generalized eigenproblem (Q7) of a batch's blocks in float32, one subgroup for each block: N + eps I = L L^T, B =
// L^-1 W, the eigenpairs (lambda, y) of the 8x8 matrix B^T B, and the participations (Q8) q_i = sum over the leading k of (L^-T B
// y_k)_i^2. The gains are the same with H = W sqrt(d) in place of W: B's columns are scaled, and the rest is repeated.
//
// W^T is appended below N as eight more rows: factorising the stack leaves B^T there. L replaces N, and B replaces W.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/finite.glsl"
#include "lib/responses.glsl"

/// Numbers in a block's solution besides those per member: eigenvalues, number of leading ones, failure.
const uint EXTRA = 10;

layout(binding = 0, std430) readonly buffer Blocks { uvec4 blocks[]; }; // first member, m, offset in its batch's matrices, -
layout(binding = 1, std430) coherent buffer Overlaps { float overlaps[]; }; // packed lower triangles; L afterwards
layout(binding = 2, std430) coherent buffer Factors { float factors[]; };   // m x 8, column by column
layout(binding = 3, std430) readonly buffer Divisors { float divisors[]; }; // block after block 2: d of qirf/rrdm.comp
layout(binding = 4, std430) coherent buffer Modes { float modes[]; };       // m x 8, column by column: L^-T B Y
layout(binding = 5, std430) writeonly buffer Solutions { float solutions[]; }; // block after block: q (m), gain (m), lambda (8), r, failed
layout(push_constant) uniform Push {
    uint first_block;
    uint count;
    uint first_member;
    float epsilon;
    float tau;
};

const uint SWEEPS = 8;    // of Jacobi rotations; convergence is quadratic from the third on
const float SLACK = 1e-6; // tolerance when the share of energy is compared with tau

shared float products[CHANNELS][CHANNELS]; // B^T B
shared float g[CHANNELS][CHANNELS]; // the matrix being diagonalised; its diagonal becomes lambda
shared float y[CHANNELS][CHANNELS]; // eigenvectors as columns
shared uint place[CHANNELS];        // columns by descending lambda

uint m, triangle_at, factor_at;

uint at(uint row, uint column) { return triangle_at + column * (2 * m - column - 1) / 2 + row; }

// The stack of N and W^T.
float entry(uint row, uint column) {
    return row < m ? overlaps[at(row, column)] : factors[factor_at + (row - m) * m + column];
}

void set_entry(uint row, uint column, float value) {
    if (row < m) overlaps[at(row, column)] = value;
    else factors[factor_at + (row - m) * m + column] = value;
}

void full_barrier() {
    memoryBarrierBuffer();
    memoryBarrierShared();
    barrier();
}

// Factorises column by column, each from the previous ones; false if a pivot is not positive, or not finite.
bool factorise(uint lane) {
    for (uint c = 0; c < m; c++) {
        float square = 0;
        for (uint k = lane; k < c; k += SUBGROUP) square += overlaps[at(c, k)] * overlaps[at(c, k)];
        float pivot = overlaps[at(c, c)] + epsilon - subgroupAdd(square);
        if (!finite(pivot) || pivot <= 0) return false;
        float root = sqrt(pivot);
        for (uint row = c + 1 + lane; row < m + CHANNELS; row += SUBGROUP) {
            float sum = entry(row, c);
            for (uint k = 0; k < c; k++) sum -= entry(row, k) * overlaps[at(c, k)];
            set_entry(row, c, sum / root);
        }
        full_barrier();
        // Written last, since no later column reads it.
        if (lane == 0) overlaps[at(c, c)] = root;
    }
    full_barrier();
    return true;
}

// Computes B^T B; false if it is not finite.
bool gram(uint lane) {
    bool sound = true;
    [[dont_unroll]] for (uint a = 0; a < CHANNELS; a++) {
        [[dont_unroll]] for (uint b = 0; b <= a; b++) {
            float sum = 0;
            for (uint row = lane; row < m; row += SUBGROUP) {
                sum += factors[factor_at + a * m + row] * factors[factor_at + b * m + row];
            }
            sum = subgroupAdd(sum);
            sound = sound && finite(sum);
            if (lane == 0) {
                products[a][b] = sum;
                products[b][a] = sum;
            }
        }
    }
    full_barrier();
    return sound;
}

// g = (B diag(scale))^T (B diag(scale)), with the identity as its eigenvectors.
void prepare(uint lane, vec2 scale) {
    for (uint k = lane; k < CHANNELS * CHANNELS; k += SUBGROUP) {
        uint a = k / CHANNELS, b = k % CHANNELS;
        g[a][b] = scale[a / RENDERING] * products[a][b] * scale[b / RENDERING];
        y[a][b] = a == b ? 1 : 0;
    }
    full_barrier();
}

// Cyclic Jacobi (Golub and Van Loan): lanes share the entries of the two rows and columns that a rotation changes.
void diagonalise(uint lane) {
    [[dont_unroll]] for (uint sweep = 0; sweep < SWEEPS; sweep++) {
        [[dont_unroll]] for (uint p = 0; p < CHANNELS - 1; p++) {
            [[dont_unroll]] for (uint q = p + 1; q < CHANNELS; q++) {
                float off = g[p][q];
                float theta = (g[q][q] - g[p][p]) / (2 * off);
                float t = (theta < 0 ? -1 : 1) / (abs(theta) + sqrt(theta * theta + 1));
                // No rotation if the entry is negligible beside the diagonal.
                bool idle = !finite(theta) || off * off <= 1e-16 * abs(g[p][p] * g[q][q]);
                t = idle ? 0 : t;
                float c = inversesqrt(1 + t * t), s = t * c;
                full_barrier();
                for (uint k = lane; k < CHANNELS; k += SUBGROUP) {
                    vec2 row = vec2(g[p][k], g[q][k]);
                    g[p][k] = c * row.x - s * row.y;
                    g[q][k] = s * row.x + c * row.y;
                }
                full_barrier();
                for (uint k = lane; k < CHANNELS; k += SUBGROUP) {
                    vec2 column = vec2(g[k][p], g[k][q]), v = vec2(y[k][p], y[k][q]);
                    g[k][p] = c * column.x - s * column.y;
                    g[k][q] = s * column.x + c * column.y;
                    y[k][p] = c * v.x - s * v.y;
                    y[k][q] = s * v.x + c * v.y;
                }
                full_barrier();
            }
        }
    }
}

// An eigenvalue, from the diagonal; one that overflowed in rotations ranks last, so that every input has an order.
float eigenvalue(uint k) { return finite(g[k][k]) ? g[k][k] : -1; }

// Sorts the eigenvalues, and returns how many reach tau of their sum; negative ones from rounding count as 0.
uint leading(uint lane) {
    for (uint k = lane; k < CHANNELS; k += SUBGROUP) {
        uint before = 0;
        float own = eigenvalue(k);
        [[dont_unroll]] for (uint o = 0; o < CHANNELS; o++) {
            float other = eigenvalue(o);
            before += other > own || (other == own && o < k) ? 1 : 0;
        }
        place[before] = k;
    }
    full_barrier();
    float total = 0;
    [[dont_unroll]] for (uint k = 0; k < CHANNELS; k++) total += max(eigenvalue(k), 0.0);
    float sum = 0;
    uint r = 0;
    do {
        sum += max(eigenvalue(place[r]), 0.0);
        r++;
    } while (r < CHANNELS && sum < (tau - SLACK) * total);
    return r;
}

// X = B diag(scale) Y over the leading r columns, then L^T X' = X from the last row up; the squared norms of the rows
// of X' are the participations.
void participate(uint lane, vec2 scale, uint r, uint out_at) {
    for (uint row = lane; row < m; row += SUBGROUP) {
        float b[CHANNELS];
        for (uint k = 0; k < CHANNELS; k++) b[k] = scale[k / RENDERING] * factors[factor_at + k * m + row];
        [[dont_unroll]] for (uint k = 0; k < CHANNELS; k++) {
            float x = 0;
            for (uint c = 0; c < CHANNELS; c++) x += b[c] * y[c][place[k]];
            modes[factor_at + k * m + row] = k < r ? x : 0;
        }
    }
    full_barrier();
    for (uint c = m; c-- > 0;) {
        float root = overlaps[at(c, c)];
        float x[CHANNELS];
        float q = 0;
        for (uint k = 0; k < CHANNELS; k++) {
            x[k] = modes[factor_at + k * m + c] / root;
            q += x[k] * x[k];
        }
        if (lane == 0) solutions[out_at + c] = q;
        for (uint row = lane; row < c; row += SUBGROUP) {
            float l = overlaps[at(c, row)];
            for (uint k = 0; k < CHANNELS; k++) modes[factor_at + k * m + row] -= l * x[k];
        }
        full_barrier();
    }
}

void main() {
    uint group = group_index();
    if (group >= count) return;
    uvec4 block = blocks[first_block + group];
    m = block.y;
    triangle_at = block.z;
    uint first = block.x - first_member;
    factor_at = CHANNELS * first;
    // Solutions of the previous blocks: two numbers for each member, and EXTRA for each block.
    uint out_at = 2 * first + EXTRA * group, extra_at = out_at + 2 * m;
    uint lane = gl_SubgroupInvocationID;
    bool good = factorise(lane) && gram(lane);
    uint r = 0;
    if (good) {
        vec2 scale = vec2(1);
        [[dont_unroll]] for (uint of_h = 0; of_h < 2; of_h++) {
            prepare(lane, scale);
            diagonalise(lane);
            uint leads = leading(lane);
            participate(lane, scale, leads, out_at + of_h * m);
            if (of_h == 0) {
                r = leads;
                for (uint k = lane; k < CHANNELS; k += SUBGROUP) solutions[extra_at + k] = max(eigenvalue(place[k]), 0.0);
            }
            scale = sqrt(vec2(divisors[2 * group], divisors[2 * group + 1]));
            full_barrier();
        }
    } else {
        for (uint k = lane; k < 2 * m + CHANNELS; k += SUBGROUP) solutions[out_at + k] = 0;
    }
    if (lane == 0) {
        solutions[extra_at + CHANNELS] = float(r);
        solutions[extra_at + (CHANNELS + 1)] = good ? 0 : 1;
    }
}
