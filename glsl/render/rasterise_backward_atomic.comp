// Adds up rasterise_backward.comp's sums by Gaussian, with the device's float atomics; see lib/backward_walk.glsl.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_shader_atomic_float : require
#include "lib/dispatch.glsl"
#include "lib/slot_sums.glsl"

layout(binding = 9, std430) buffer PositionSums { float position_sums[]; }; // by Gaussian, four floats: 1, u, v, red
layout(binding = 10, std430) buffer CovarianceSums { float covariance_sums[]; }; // uu, uv, vv, green
layout(binding = 11, std430) buffer BlueSums { float blue_sums[]; };

void add_position(uint at, float x) { atomicAdd(position_sums[at], x); }
void add_covariance(uint at, float x) { atomicAdd(covariance_sums[at], x); }
void add_blue(uint at, float x) { atomicAdd(blue_sums[at], x); }

const bool RESIDUAL = false;

void hand_in(uint slot, uint gaussian, float sums[SUMS_MOST]) {
    [[unroll]] for (uint k = 0; k < 4; k++) {
        add_position(4 * gaussian + k, sums[k]);
        add_covariance(4 * gaussian + k, sums[4 + k]);
    }
    add_blue(gaussian, sums[8]);
}

void hand_in_nothing(uint slot) {}

#include "lib/backward_walk.glsl"
