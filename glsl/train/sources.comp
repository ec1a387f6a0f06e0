// Density control: the source of each row of the new model, given the scan of the copies.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/density.glsl"

layout(binding = 0, std430) readonly buffer Count { uint count[]; }; // of the old model
layout(binding = 1, std430) readonly buffer Copies { uint copies[]; };
layout(binding = 2, std430) readonly buffer Splits { uint splits[]; };
layout(binding = 3, std430) readonly buffer Offsets { uint offsets[]; };
layout(binding = 4, std430) writeonly buffer Sources { uint sources[]; }; // rows of the old model
layout(binding = 5, std430) writeonly buffer Kinds { uint kinds[]; };     // lib/density.glsl

void main() {
    uint i = global_index();
    if (i >= count[0]) return;
    for (uint c = 0; c < copies[i]; c++) {
        sources[offsets[i] + c] = i;
        kinds[offsets[i] + c] = copies[i] == 2 && splits[i] != 0 ? HALF + c : c; // HALF, OTHER_HALF; or KEPT, CLONE
    }
}
