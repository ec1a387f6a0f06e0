// Exclusive prefix sum in three phases: sums of blocks, scan of those sums by one workgroup, which also sets the total
// as a count, scan within blocks. If blocks are few, each sums all previous ones in the last phase, and the second
// phase is left out. There is no look-back, which needs forward progress that software devices do not guarantee.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

/// Phase: sums of blocks.
const uint REDUCE = 0;
/// Phase: scan of those sums, and their total, by one workgroup.
const uint SPINE = 1;
/// Phase: scan within blocks.
const uint APPLY = 2;

layout(constant_id = 2) const uint PHASE = REDUCE;
layout(constant_id = 3) const uint ROWS = 16;
// True if the elements are source[indices[i]]; the first phase then leaves them in `target`.
layout(constant_id = 4) const bool GATHER = false;
layout(constant_id = 5) const bool FEW_BLOCKS = false; // true if there is no second phase

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Indices { uint indices[]; };
layout(binding = 2, std430) readonly buffer Source { uint source[]; };
layout(binding = 3, std430) buffer Sums { uint sums[]; };
layout(binding = 4, std430) buffer Target { uint target[]; };
layout(binding = 5, std430) buffer Value { uint value[]; }; // 0: the total, or 0 beyond its limit; 1: the largest ever needed
layout(binding = 6, std430) writeonly buffer Arguments { uint arguments[]; };
layout(push_constant) uniform Push { uint limit; uint sizes[4]; };

#include "lib/counts.glsl"
#include "lib/scan.glsl"

void reduce(uint n) {
    uint sum = 0;
    uint at = first_element();
    for (uint row = 0; row < ROWS; row++, at += SUBGROUP) {
        uint own = 0;
        if (at < n) {
            own = source[GATHER ? indices[at] : at];
            if (GATHER) target[at] = own;
        }
        sum = saturated(sum, own);
    }
    sum = sum_of_workgroup(sum);
    if (gl_LocalInvocationID.x == 0 && group_index() * BLOCK < n) sums[group_index()] = sum;
}

void spine(uint n) {
    uint blocks = (n + BLOCK - 1) / BLOCK;
    uint carry = 0;
    for (uint start = 0; start < blocks; start += WORKGROUP) {
        uint at = start + gl_SubgroupID * SUBGROUP + gl_SubgroupInvocationID;
        uint own = at < blocks ? sums[at] : 0;
        uint inclusive = saturated(subgroupInclusiveAdd(halves(own)));
        if (gl_SubgroupInvocationID == SUBGROUP - 1) partial[gl_SubgroupID] = inclusive;
        barrier();
        if (at < blocks) sums[at] = carry + before(gl_SubgroupID) + inclusive - own;
        carry = saturated(carry, before(SUBGROUPS));
        barrier();
    }
    if (gl_LocalInvocationID.x == 0) set_count(carry, limit, sizes);
}

uint element(uint at) { return GATHER ? target[at] : source[at]; }

void apply_block(uint n) {
    uint sum = 0;
    uint at = first_element();
    for (uint row = 0; row < ROWS; row++, at += SUBGROUP) sum += at < n ? element(at) : 0;
    uint carry = before_run(sum) + before_block(n);
    if (group_index() * BLOCK >= n) return;
    at = first_element();
    for (uint row = 0; row < ROWS; row++, at += SUBGROUP) {
        uint own = at < n ? element(at) : 0;
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
