// Mean over the colours of |picture - photo|, into the fourth component of the image gradient.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/photo.glsl"

layout(constant_id = 2) const uint ALPHA = OPAQUE; // meaning of the photo's fourth byte: lib/photo.glsl

layout(binding = 0, std430) readonly buffer Image { float image[]; };          // red, green, blue, alpha
layout(binding = 1, std430) readonly buffer Photo { uint photo[]; };           // RGBA, 8 bits each
layout(binding = 2, std430) writeonly buffer Gradient { float gradient[]; };   // red, green, blue, residual
layout(push_constant) uniform Push {
    vec4 background;
    uint pixels;
};

void main() {
    uint p = global_index();
    if (p >= pixels) return;
    vec4 truth = unpackUnorm4x8(photo[p]);
    if (ALPHA == OPACITY) truth.rgb = mix(background.rgb, truth.rgb, truth.a);
    vec3 d = abs(vec3(image[4 * p], image[4 * p + 1], image[4 * p + 2]) - truth.rgb);
    gradient[4 * p + 3] = (d.r + d.g + d.b) / 3;
}
