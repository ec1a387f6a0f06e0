// Reports each invocation's subgroup as seen from inside; the host compares it with the width that kernels are
// specialised for.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) writeonly buffer Result { uvec4 seen[]; };

void main() {
    uint lanes = subgroupAdd(1u);
    seen[global_index()] = uvec4(lanes, gl_SubgroupSize, gl_NumSubgroups, gl_SubgroupID << 16 | gl_SubgroupInvocationID);
}
