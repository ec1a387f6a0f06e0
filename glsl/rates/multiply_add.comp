// Multiply-adds alone: CHAINS of them in parallel, each depending only on itself, so that the units stay busy.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"

/// Steps of every chain in a round of the loop.
const uint UNROLLED = 8;

layout(constant_id = 2) const uint CHAINS = 12;

layout(binding = 0, std430) writeonly buffer Sums { float sums[]; };
layout(push_constant) uniform Push { uint rounds; float factor; float term; };

void main() {
    float chain[CHAINS];
    [[unroll]] for (uint k = 0; k < CHAINS; k++) chain[k] = float(gl_LocalInvocationID.x + k);
    for (uint round = 0; round < rounds; round++) {
        [[unroll]] for (uint step = 0; step < UNROLLED; step++) {
            [[unroll]] for (uint k = 0; k < CHAINS; k++) chain[k] = fma(chain[k], factor, term);
        }
    }
    // The sum is written so that no compiler removes the work.
    float sum = 0;
    [[unroll]] for (uint k = 0; k < CHAINS; k++) sum += chain[k];
    sums[global_index()] = sum;
}
