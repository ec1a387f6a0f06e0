// Adds up rasterise_backward.comp's sums by Gaussian on devices without float atomics: words are compared and swapped until
// no other invocation has intervened. See lib/backward_walk.glsl.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/slot_sums.glsl"

layout(binding = 9, std430) buffer PositionSums { uint position_sums[]; }; // by Gaussian, four words: 1, u, v, red
layout(binding = 10, std430) buffer CovarianceSums { uint covariance_sums[]; }; // uu, uv, vv, green
layout(binding = 11, std430) buffer BlueSums { uint blue_sums[]; };

uint sum_of(uint word, float x) { return floatBitsToUint(uintBitsToFloat(word) + x); }

void add_position(uint at, float x) {
    for (uint seen = position_sums[at], old;; seen = old) {
        old = atomicCompSwap(position_sums[at], seen, sum_of(seen, x));
        if (old == seen) return;
    }
}

void add_covariance(uint at, float x) {
    for (uint seen = covariance_sums[at], old;; seen = old) {
        old = atomicCompSwap(covariance_sums[at], seen, sum_of(seen, x));
        if (old == seen) return;
    }
}

void add_blue(uint at, float x) {
    for (uint seen = blue_sums[at], old;; seen = old) {
        old = atomicCompSwap(blue_sums[at], seen, sum_of(seen, x));
        if (old == seen) return;
    }
}

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
