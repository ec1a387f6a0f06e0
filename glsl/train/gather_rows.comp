// Gathers rows of WIDTH floats by source row. With FRESH, new rows become zero: the moments of new Gaussians.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/density.glsl"

layout(constant_id = 2) const uint WIDTH = 3;
layout(constant_id = 3) const bool FRESH = false;

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Sources { uint sources[]; };
layout(binding = 2, std430) readonly buffer Kinds { uint kinds[]; };
layout(binding = 3, std430) readonly buffer Source { float source[]; };
layout(binding = 4, std430) writeonly buffer Target { float target[]; };

void main() {
    uint row = global_index();
    if (row >= count[0]) return;
    bool zero = FRESH && kinds[row] != KEPT;
    [[dont_unroll]] for (uint c = 0; c < WIDTH; c++) target[row * WIDTH + c] = zero ? 0 : source[sources[row] * WIDTH + c];
}
