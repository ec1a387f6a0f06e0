// Adds up rasterise_backward.comp's sums by Gaussian, with the device's float atomics; see lib/backward_walk.glsl.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_shader_atomic_float : require
#include "lib/dispatch.glsl"

layout(binding = 9, std430) buffer PositionSums { float position_sums[]; }; // by Gaussian, four floats: 1, u, v
layout(binding = 10, std430) buffer CovarianceSums { float covariance_sums[]; }; // uu, uv, vv
layout(binding = 11, std430) buffer ColourSums { float colour_sums[]; }; // red, green, blue

void add_position(uint at, float x) { atomicAdd(position_sums[at], x); }
void add_covariance(uint at, float x) { atomicAdd(covariance_sums[at], x); }
void add_colour(uint at, float x) { atomicAdd(colour_sums[at], x); }

const bool RESIDUAL = false;

void hand_in(uint slot, uint gaussian, vec4 position, vec4 covariance, vec4 colour) {
    [[unroll]] for (uint k = 0; k < 3; k++) {
        add_position(4 * gaussian + k, position[k]);
        add_covariance(4 * gaussian + k, covariance[k]);
        add_colour(4 * gaussian + k, colour[k]);
    }
}

void hand_in_none(uint slot) {}

#include "lib/backward_walk.glsl"
