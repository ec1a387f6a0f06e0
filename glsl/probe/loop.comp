// Adds up the numbers to one given at run time: tests whether the driver runs long loops to their end.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) writeonly buffer Result { uint result[]; };
layout(push_constant) uniform Push { uint iterations; };

void main() {
    uint sum = 0;
    for (uint i = 1; i <= iterations; i++) {
        sum += i;
        // Prevents the compiler from finding the closed form.
        if (sum == 0xFFFFFFFFu && iterations == 0) result[0] = i;
    }
    if (global_index() == 0) result[0] = sum;
}
