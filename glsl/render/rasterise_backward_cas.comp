// rasterise_backward.comp's sums added up by Gaussian on devices without float atomics: words are compared and swapped until
// nobody came in between. See lib/atomic_backward.glsl.
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

#include "lib/atomic_backward.glsl"
