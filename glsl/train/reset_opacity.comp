// Opacity reset: opacities are held below a limit, and their moments become zero.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/finite.glsl"

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) buffer Logits { float logits[]; };
layout(binding = 2, std430) writeonly buffer LogitsAdam { vec2 logits_adam[]; };
layout(push_constant) uniform Push { float limit; };

void main() {
    uint i = global_index();
    if (i >= count[0]) return;
    // One that is not a number stays so, and its Gaussian goes with the next density step.
    if (!nan(logits[i])) logits[i] = min(logits[i], limit);
    logits_adam[i] = vec2(0);
}
