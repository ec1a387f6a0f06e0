// Exclusive prefix sum in three phases: sums of blocks, scan of those sums by one workgroup, scan within blocks.
// Each subgroup owns a contiguous run of ROWS x SUBGROUP elements. There is no look-back, which needs forward progress that
// software devices do not guarantee.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

/// Phase: sums of blocks.
const uint REDUCE = 0;
/// Phase: scan of those sums, by one workgroup.
const uint SPINE = 1;
/// Phase: scan within blocks.
const uint APPLY = 2;

layout(constant_id = 2) const uint PHASE = REDUCE;
layout(constant_id = 3) const uint ROWS = 16;

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Source { uint source[]; };
layout(binding = 2, std430) buffer Sums { uint sums[]; };
layout(binding = 3, std430) buffer Target { uint target[]; };
layout(binding = 4, std430) buffer Total { uint total[]; };

const uint SUBGROUPS = WORKGROUP / SUBGROUP;
const uint BLOCK = WORKGROUP * ROWS;
shared uint partial[SUBGROUPS];

// Sum of `partial` over the subgroups before this one.
uint before_subgroup() {
    uint sum = 0;
    for (uint s = 0; s < gl_SubgroupID; s++) sum += partial[s];
    return sum;
}

uint first_element() {
    return group_index() * BLOCK + gl_SubgroupID * SUBGROUP * ROWS + gl_SubgroupInvocationID;
}

void reduce(uint n) {
    uint sum = 0;
    uint at = first_element();
    for (uint row = 0; row < ROWS; row++, at += SUBGROUP) sum += at < n ? source[at] : 0;
    sum = subgroupAdd(sum);
    if (subgroupElect()) partial[gl_SubgroupID] = sum;
    barrier();
    if (gl_LocalInvocationID.x == 0) {
        uint all = 0;
        for (uint s = 0; s < SUBGROUPS; s++) all += partial[s];
        if (group_index() * BLOCK < n) sums[group_index()] = all;
    }
}

void spine(uint n) {
    uint blocks = (n + BLOCK - 1) / BLOCK;
    uint carry = 0;
    for (uint start = 0; start < blocks; start += WORKGROUP) {
        uint at = start + gl_SubgroupID * SUBGROUP + gl_SubgroupInvocationID;
        uint own = at < blocks ? sums[at] : 0;
        uint inclusive = subgroupInclusiveAdd(own);
        if (gl_SubgroupInvocationID == SUBGROUP - 1) partial[gl_SubgroupID] = inclusive;
        barrier();
        if (at < blocks) sums[at] = carry + before_subgroup() + inclusive - own;
        for (uint s = 0; s < SUBGROUPS; s++) carry += partial[s];
        barrier();
    }
    if (gl_LocalInvocationID.x == 0) total[0] = carry;
}

void apply_block(uint n) {
    uint sum = 0;
    uint at = first_element();
    for (uint row = 0; row < ROWS; row++, at += SUBGROUP) sum += at < n ? source[at] : 0;
    sum = subgroupAdd(sum);
    if (subgroupElect()) partial[gl_SubgroupID] = sum;
    barrier();
    if (group_index() * BLOCK >= n) return;
    uint carry = sums[group_index()] + before_subgroup();
    at = first_element();
    for (uint row = 0; row < ROWS; row++, at += SUBGROUP) {
        uint own = at < n ? source[at] : 0;
        uint inclusive = subgroupInclusiveAdd(own);
        if (at < n) target[at] = carry + inclusive - own;
        carry += subgroupBroadcast(inclusive, SUBGROUP - 1);
    }
}

void main() {
    uint n = count[0];
    if (PHASE == REDUCE) reduce(n);
    else if (PHASE == SPINE) spine(n);
    else apply_block(n);
}
