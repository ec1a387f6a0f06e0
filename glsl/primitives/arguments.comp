// Turns a count in device memory into dispatch sizes.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) buffer Value { uint value[]; }; // 0: count, 1: largest count ever needed
layout(binding = 1, std430) writeonly buffer Arguments { uint arguments[]; };
layout(push_constant) uniform Push { uint limit; uint sizes[4]; };

#include "lib/counts.glsl"

void main() {
    if (global_index() == 0) set_count(value[0], limit, sizes);
}
