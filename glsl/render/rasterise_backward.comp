// Backward of the rasterisation, lib/backward_walk.glsl: a splat's sums go to the slot that the Gaussian owns in this tile. No
// atomics: the same bits run after run.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"

layout(constant_id = 5) const bool RESIDUAL = false;

layout(binding = 9, std430) writeonly buffer MomentsA { vec4 moments_a[]; }; // by slot: 1, u, v; where RESIDUAL, sum of T alpha
layout(binding = 10, std430) writeonly buffer MomentsB { vec4 moments_b[]; }; // uu, uv, vv; where RESIDUAL, sum of alpha
layout(binding = 11, std430) writeonly buffer MomentsC { vec4 moments_c[]; }; // red, green, blue; where RESIDUAL, sum of T alpha x residual

void hand_in(uint slot, uint gaussian, vec4 a, vec4 b, vec4 c) {
    moments_a[slot] = a;
    moments_b[slot] = b;
    moments_c[slot] = c;
}

// The slot is summed whether drawn or not.
void hand_in_none(uint slot) { hand_in(slot, 0, vec4(0), vec4(0), vec4(0)); }

#include "lib/backward_walk.glsl"
