// rasterise_backward.comp's sums added up by Gaussian on devices without float atomics: words are compared and swapped until
// nobody came in between. See lib/backward_walk.glsl.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"

layout(binding = 9, std430) buffer SumsA { uint sums_a[]; }; // by Gaussian, four floats: 1, u, v
layout(binding = 10, std430) buffer SumsB { uint sums_b[]; }; // uu, uv, vv
layout(binding = 11, std430) buffer SumsC { uint sums_c[]; }; // red, green, blue

uint sum_of(uint word, float x) { return floatBitsToUint(uintBitsToFloat(word) + x); }

void add_a(uint at, float x) {
    for (uint seen = sums_a[at], old;; seen = old) {
        old = atomicCompSwap(sums_a[at], seen, sum_of(seen, x));
        if (old == seen) return;
    }
}

void add_b(uint at, float x) {
    for (uint seen = sums_b[at], old;; seen = old) {
        old = atomicCompSwap(sums_b[at], seen, sum_of(seen, x));
        if (old == seen) return;
    }
}

void add_c(uint at, float x) {
    for (uint seen = sums_c[at], old;; seen = old) {
        old = atomicCompSwap(sums_c[at], seen, sum_of(seen, x));
        if (old == seen) return;
    }
}

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
