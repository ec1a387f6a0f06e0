// Stream compaction: writes the indices whose flags are set, in order, given the scan of the flags.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Flags { uint flags[]; };
layout(binding = 2, std430) readonly buffer Offsets { uint offsets[]; };
layout(binding = 3, std430) writeonly buffer Indices { uint indices[]; };

void main() {
    uint i = global_index();
    if (i < count[0] && flags[i] != 0) indices[offsets[i]] = i;
}
