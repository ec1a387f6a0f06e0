// Masks: parts hidden by a photo's mask become background in both pictures, so that they add nothing to the loss.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

/// Phase: hides parts of the picture.
const uint HIDE = 0;
/// Phase: propagates the gradient back through that.
const uint BACKWARD = 1;

layout(constant_id = 2) const uint PHASE = HIDE;

layout(binding = 0, std430) readonly buffer Photo { uint photo[]; }; // fourth byte: weight of the pixel
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
    if (PHASE == HIDE) masked[p] = vec4(image[p].rgb * counts + background.rgb * (1 - counts), image[p].a);
    else gradient[p] = vec4(gradient[p].rgb * counts, gradient[p].a);
}
