// The first pair of each tile, by binary search in the sorted keys; one more entry holds the end of the last tile.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; };
layout(binding = 1, std430) readonly buffer Keys { uint keys[]; };
layout(binding = 2, std430) writeonly buffer Starts { uint starts[]; };
layout(push_constant) uniform Push { uint tiles; };

void main() {
    uint tile = global_index();
    if (tile > tiles) return;
    uint low = 0, high = pairs[0];
    while (low < high) {
        uint middle = (low + high) / 2;
        if (keys[middle] < tile) low = middle + 1;
        else high = middle;
    }
    starts[tile] = low;
}
