// Masks: what a photo's mask hides is background in both pictures, so that it adds nothing to the loss.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

// 0 hides parts of the picture, 1 takes the gradient back through that
layout(constant_id = 2) const uint PHASE = 0;

layout(binding = 0, std430) readonly buffer Photo { uint photo[]; }; // the fourth byte: how much of a pixel counts
layout(binding = 1, std430) readonly buffer Image { vec4 image[]; };
layout(binding = 2, std430) writeonly buffer Masked { vec4 masked[]; };
layout(binding = 3, std430) buffer Gradient { vec4 gradient[]; };
layout(push_constant) uniform Push {
    vec4 background;
    uint pixels;
};

void main() {
    uint p = global_index();
    if (p >= pixels) return;
    float counts = float(photo[p] >> 24) / 255.0;
    if (PHASE == 0) masked[p] = vec4(image[p].rgb * counts + background.rgb * (1 - counts), image[p].a);
    else gradient[p] = vec4(gradient[p].rgb * counts, gradient[p].a);
}
