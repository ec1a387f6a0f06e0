// Sum of an array by one workgroup, in a fixed order: for results that the host reads occasionally.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) readonly buffer Source { vec4 source[]; };
layout(binding = 1, std430) writeonly buffer Sum { vec4 sum[]; };
layout(push_constant) uniform Push { uint count; };

shared vec4 partial[WORKGROUP];

void main() {
    uint lane = gl_LocalInvocationID.x;
    vec4 own = vec4(0);
    for (uint i = lane; i < count; i += WORKGROUP) own += source[i];
    partial[lane] = own;
    for (uint step = WORKGROUP / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) partial[lane] += partial[lane + step];
    }
    if (lane == 0) sum[0] = partial[0];
}
