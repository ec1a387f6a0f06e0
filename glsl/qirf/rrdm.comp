// The factor W (m x 8) of each block's radiance-response density matrix P = W W^T (Q5), and on request P itself (Q6): W
// = [sqrt(eta / (tr_r + eps)) H_r, sqrt((1 - eta) / (tr_o + eps)) H_o], where the traces are sums of squares over the
// block. The rows of H (Q3) already contain the weights sqrt(eta) and sqrt(1 - eta), so W = H / sqrt(d) with d = trace
// / weight + eps; the host gets d, too, and recovers H as W sqrt(d).
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/responses.glsl"
#include "lib/blocks.glsl"

/// Phase: W, one subgroup for each block.
const uint FACTOR = 0;
/// Phase: P, one subgroup for each tile, as in `qirf/overlap.comp`.
const uint DENSITY = 1;

layout(constant_id = 2) const uint PHASE = FACTOR;
layout(constant_id = 3) const uint COLUMNS = 64;

layout(binding = 0, std430) readonly buffer Blocks { uvec4 blocks[]; }; // first member, m, offset in its batch's matrices, -
layout(binding = 1, std430) readonly buffer Tiles { uvec2 tiles[]; };   // block, first row and first column: lib/blocks.glsl
layout(binding = 2, std430) readonly buffer Members { uint members[]; };
layout(binding = 3, std430) readonly buffer H { float h[]; };           // n x CHANNELS, weighted
layout(binding = 4, std430) buffer Factors { float factors[]; };        // block after block m x CHANNELS, column by column
layout(binding = 5, std430) writeonly buffer Densities { float densities[]; }; // lower triangles, packed as the overlaps
layout(binding = 6, std430) writeonly buffer Divisors { float divisors[]; }; // block after block d of both groups of channels
layout(push_constant) uniform Push {
    uint first;        // block or tile
    uint count;
    uint first_member;
    uint first_block;
    float eta;
    float epsilon;
};

void factor(uint block_index) {
    uvec4 block = blocks[block_index];
    uint m = block.y, at = CHANNELS * (block.x - first_member);
    uint lane = gl_SubgroupInvocationID;
    vec2 trace = vec2(0);
    for (uint row = lane; row < m; row += SUBGROUP) {
        uint i = CHANNELS * members[block.x + row];
        [[unroll]] for (uint k = 0; k < CHANNELS; k++) trace[k / RENDERING] += h[i + k] * h[i + k];
    }
    vec2 share = vec2(eta, 1 - eta);
    bvec2 counts = greaterThan(share, vec2(0));
    vec2 divisor = mix(vec2(0), subgroupAdd(trace) / share + epsilon, counts);
    // A divisor of 0 belongs to channels that are themselves zero.
    vec2 weight = mix(vec2(0), inversesqrt(divisor), greaterThan(divisor, vec2(0)));
    if (lane < 2) divisors[2 * (block_index - first_block) + lane] = divisor[lane];
    for (uint row = lane; row < m; row += SUBGROUP) {
        uint i = CHANNELS * members[block.x + row];
        [[unroll]] for (uint k = 0; k < CHANNELS; k++) factors[at + k * m + row] = weight[k / RENDERING] * h[i + k];
    }
}

void density(uvec2 tile) {
    uvec4 block = blocks[tile.x];
    uint m = block.y, at = CHANNELS * (block.x - first_member);
    uint row = (tile.y >> ROW_SHIFT) + gl_SubgroupInvocationID;
    uint first_column = tile.y & COLUMN_MASK;
    float own[CHANNELS];
    [[unroll]] for (uint k = 0; k < CHANNELS; k++) own[k] = factors[at + k * m + min(row, m - 1)];
    uint end = min(min(first_column + COLUMNS, (tile.y >> ROW_SHIFT) + SUBGROUP), m);
    for (uint column = first_column; column < end; column++) {
        float sum = 0;
        [[unroll]] for (uint k = 0; k < CHANNELS; k++) sum += own[k] * factors[at + k * m + column];
        if (column <= row && row < m) densities[block.z + column * (2 * m - column - 1) / 2 + row] = sum;
    }
}

void main() {
    uint group = group_index();
    if (group >= count) return;
    if (PHASE == FACTOR) factor(first + group);
    else density(tiles[first + group]);
}
