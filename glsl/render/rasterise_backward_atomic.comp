// rasterise_backward.comp's sums added up by Gaussian with the device's float atomics: lib/backward_walk.glsl.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#extension GL_EXT_shader_atomic_float : require
#include "lib/dispatch.glsl"

layout(binding = 9, std430) buffer SumsA { float sums_a[]; }; // by Gaussian, four floats: 1, u, v
layout(binding = 10, std430) buffer SumsB { float sums_b[]; }; // uu, uv, vv
layout(binding = 11, std430) buffer SumsC { float sums_c[]; }; // red, green, blue

void add_a(uint at, float x) { atomicAdd(sums_a[at], x); }
void add_b(uint at, float x) { atomicAdd(sums_b[at], x); }
void add_c(uint at, float x) { atomicAdd(sums_c[at], x); }

const bool RESIDUAL = false;

void hand_in(uint slot, uint gaussian, vec4 a, vec4 b, vec4 c) {
    [[unroll]] for (uint k = 0; k < 3; k++) {
        add_a(4 * gaussian + k, a[k]);
        add_b(4 * gaussian + k, b[k]);
        add_c(4 * gaussian + k, c[k]);
    }
}

void hand_in_none(uint slot) {}

#include "lib/backward_walk.glsl"
