// Sums rows of WIDTH floats over contiguous segments, each in row order: bit-identical run after run.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(constant_id = 2) const uint WIDTH = 1;

layout(binding = 0, std430) readonly buffer Count { uint count[]; }; // segments
layout(binding = 1, std430) readonly buffer Starts { uint starts[]; };
layout(binding = 2, std430) readonly buffer Lengths { uint lengths[]; };
layout(binding = 3, std430) readonly buffer Rows { float rows[]; };
layout(binding = 4, std430) writeonly buffer Sums { float sums[]; };

void main() {
    uint segment = global_index();
    if (segment >= count[0]) return;
    uint start = starts[segment];
    uint end = start + lengths[segment];
    for (uint c = 0; c < WIDTH; c++) {
        float sum = 0;
        for (uint row = start; row < end; row++) sum += rows[row * WIDTH + c];
        sums[segment * WIDTH + c] = sum;
    }
}
