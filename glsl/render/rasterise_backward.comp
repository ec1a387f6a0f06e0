// Backward pass of the rasterisation (lib/backward_walk.glsl): a splat's sums go to the slot that the Gaussian owns in this
// tile. Without atomics the result has the same bits run after run.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"

layout(constant_id = 5) const bool RESIDUAL = false;

layout(binding = 9, std430) writeonly buffer PositionSums { vec4 position_sums[]; }; // by slot: 1, u, v; where RESIDUAL, sum of T alpha
layout(binding = 10, std430) writeonly buffer CovarianceSums { vec4 covariance_sums[]; }; // uu, uv, vv; where RESIDUAL, sum of alpha
layout(binding = 11, std430) writeonly buffer ColourSums { vec4 colour_sums[]; }; // red, green, blue; where RESIDUAL, sum of T alpha x residual

void hand_in(uint slot, uint gaussian, vec4 position, vec4 covariance, vec4 colour) {
    position_sums[slot] = position;
    covariance_sums[slot] = covariance;
    colour_sums[slot] = colour;
}

// The projection's backward pass adds up every slot, drawn or not.
void hand_in_none(uint slot) { hand_in(slot, 0, vec4(0), vec4(0), vec4(0)); }

#include "lib/backward_walk.glsl"
