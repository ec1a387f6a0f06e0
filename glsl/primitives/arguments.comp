// Turns a count in device memory into dispatch sizes: one triple for each of four group sizes. A count beyond its limit
// becomes 0, so that all later passes over it do nothing; the number that was needed is kept.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) readonly buffer Source { uint source[]; };
layout(binding = 1, std430) buffer Value { uint value[]; }; // 0: count, 1: largest count ever needed
layout(binding = 2, std430) writeonly buffer Arguments { uint arguments[]; };
// count = ceil(source / per) x times
layout(push_constant) uniform Push { uint per; uint times; uint limit; uint sizes[4]; };

/// Workgroups of one dimension of a dispatch: the least that Vulkan promises; more go into a second dimension.
const uint MAX_GROUPS = 65535;
/// The same where a test asks for other orders: small dispatches then have the surplus workgroups of long ones.
const uint FEW_GROUPS = 67;

void main() {
    if (global_index() != 0) return;
    uint parts = source[0] / per + (source[0] % per != 0 ? 1 : 0);
    uint count = parts > 0xffffffff / times ? 0xffffffff : parts * times; // saturates, as totals of scans do
    value[1] = max(value[1], count);
    if (count > limit) count = 0;
    value[0] = count;
    for (uint i = 0; i < 4; i++) {
        uint groups = count / sizes[i] + (count % sizes[i] != 0 ? 1 : 0);
        uint most = BACKWARDS ? FEW_GROUPS : MAX_GROUPS;
        arguments[3 * i] = min(groups, most);
        arguments[3 * i + 1] = (groups + most - 1) / most;
        arguments[3 * i + 2] = 1;
    }
}
