// Opacity reset: limits opacities, and sets their moments to zero.
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
    // NaN stays NaN, and the next density step prunes its Gaussian.
    if (!nan(logits[i])) logits[i] = min(logits[i], limit);
    logits_adam[i] = vec2(0);
}
