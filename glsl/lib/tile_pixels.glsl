// A tile's list of splats and its pixels, as read by all further walks over a picture, and each pixel's transmittance.
#include "lib/blending.glsl"
#include "lib/view.glsl"
#include "lib/splat.glsl"

layout(constant_id = 2) const uint TILE = 16;
layout(constant_id = 3) const uint PIXELS = 8; // TILE x TILE / WORKGROUP
layout(constant_id = 4) const float STOP = TRANSMITTANCE_STOP;

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Starts { uint starts[]; };
layout(binding = 2, std430) readonly buffer Slots { uint slots[]; };
layout(binding = 3, std430) readonly buffer Owners { uint owners[]; };
layout(binding = 4, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 5, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 6, std430) readonly buffer Colour { vec2 colour[]; };
layout(binding = 7, std430) readonly buffer Image { vec4 image[]; };

vec2 centre[PIXELS]; // from the view's origin
float transmittance[PIXELS]; // 0 once the pixel is done

// Sets a pixel's position. Returns its index in the picture, or -1 outside.
int place(uint p, uvec2 at) {
    uvec2 size = view[0].size;
    bool inside = all(lessThan(at, size));
    centre[p] = vec2(at) + 0.5 - origin(view[0]);
    transmittance[p] = inside ? 1 : 0;
    return inside ? int(at.y * size.x + at.x) : -1;
}

bool done() {
    float most = transmittance[0];
    [[unroll]] for (uint p = 1; p < PIXELS; p++) most = max(most, transmittance[p]);
    return most <= 0;
}
