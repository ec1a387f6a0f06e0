// Reports each invocation's subgroup as seen from inside; the host compares it with the width that kernels are
// specialised for. It also adds up over the lanes after loops whose lengths differ by lane, in loops whose lengths differ by
// subgroup, as the rasterisers do: the lanes have to meet again after the inner loop.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) writeonly buffer Result { uvec4 seen[]; };
layout(binding = 1, std430) writeonly buffer Added { uint added[]; };

// Steps of the Collatz sequence from n to 1: no compiler finds a closed form.
uint steps(uint n) {
    uint count = 0;
    for (; n > 1; count++) n = (n & 1) != 0 ? 3 * n + 1 : n / 2;
    return count;
}

void main() {
    uint lanes = subgroupAdd(1u);
    seen[global_index()] = uvec4(lanes, gl_SubgroupSize, gl_NumSubgroups, gl_SubgroupID << 16 | gl_SubgroupInvocationID);
    uint all = 0;
    for (uint round = 0; round <= gl_SubgroupID; round++) all += subgroupAdd(steps(gl_SubgroupInvocationID + round + 1));
    added[global_index()] = all;
}
