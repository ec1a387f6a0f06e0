// Copies words: a run for each workgroup, neighbouring words for neighbouring lanes.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(constant_id = 2) const uint ROWS = 16; // words per invocation

layout(binding = 0, std430) readonly buffer Source { float source[]; };
layout(binding = 1, std430) writeonly buffer Target { float target[]; };
layout(push_constant) uniform Push { uint count; };

void main() {
    uint at = group_index() * WORKGROUP * ROWS + gl_LocalInvocationID.x;
    for (uint row = 0; row < ROWS && at < count; row++, at += WORKGROUP) target[at] = source[at];
}
