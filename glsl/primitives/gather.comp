// target[i] = source[indices[i]]
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Indices { uint indices[]; };
layout(binding = 2, std430) readonly buffer Source { uint source[]; };
layout(binding = 3, std430) writeonly buffer Target { uint target[]; };

void main() {
    uint i = global_index();
    if (i < count[0]) target[i] = source[indices[i]];
}
