// Halves a photo's size: each pixel becomes the mean of four, colours weighted by their opacities. An odd last row or
// column is left out.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) readonly buffer Photo { uint photo[]; }; // RGBA, colours not multiplied by alpha
layout(binding = 1, std430) writeonly buffer Halved { uint halved[]; };
layout(push_constant) uniform Push {
    uvec2 size; // of the photo
};

void main() {
    uvec2 to = size / 2;
    uint p = global_index();
    if (p >= to.x * to.y) return;
    uint corner = 2 * (p / to.x) * size.x + 2 * (p % to.x);
    // Sums are integers, so that every device rounds alike.
    uvec4 sum = uvec4(0);
    uvec3 plain = uvec3(0);
    for (uint k = 0; k < 4; k++) {
        uint texel = photo[corner + (k >> 1) * size.x + (k & 1)];
        uvec3 colour = uvec3(texel, texel >> 8, texel >> 16) & 255u;
        uint alpha = texel >> 24;
        sum += uvec4(colour * alpha, alpha);
        plain += colour;
    }
    uvec3 colour = sum.a == 0 ? (plain + 2) / 4 : (sum.rgb + sum.a / 2) / sum.a;
    halved[p] = colour.r | colour.g << 8 | colour.b << 16 | (sum.a + 2) / 4 << 24;
}
