// Backward pass of the rasterisation (lib/backward_walk.glsl): a splat's sums go to the slot of its Gaussian in this
// tile. Without atomics, the result has the same bits in every run.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/slot_sums.glsl"

layout(constant_id = 5) const bool RESIDUAL = false;

layout(binding = 9, std430) writeonly buffer PositionSums { vec4 position_sums[]; }; // by slot: 1, u, v, red
layout(binding = 10, std430) writeonly buffer CovarianceSums { vec4 covariance_sums[]; }; // uu, uv, vv, green
layout(binding = 11, std430) writeonly buffer BlueSums { float blue_sums[]; };
layout(binding = 12, std430) writeonly buffer ResponseSums { vec4 response_sums[]; }; // only if RESIDUAL; the last is unused

void hand_in(uint slot, uint gaussian, float sums[SUMS_MOST]) {
    position_sums[slot] = vec4(sums[0], sums[1], sums[2], sums[3]);
    covariance_sums[slot] = vec4(sums[4], sums[5], sums[6], sums[7]);
    blue_sums[slot] = sums[8];
    if (RESIDUAL) response_sums[slot] = vec4(sums[9], sums[10], sums[11], 0);
}

// The projection's backward pass adds up every slot, drawn or not.
void hand_in_nothing(uint slot) { hand_in(slot, 0, float[](0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)); }

#include "lib/backward_walk.glsl"
