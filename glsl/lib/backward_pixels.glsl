// A pixel's part in the backward pass of the rasterisation: what both ways of walking a tile's list share.
//
// With q = dL/dC . c and R the part of dL/dC . C that lies behind, dL/dalpha = T q - R / (1 - alpha): each pixel carries one
// scalar instead of three. With h = alpha dL/dalpha the sums are the moments of h over (u, v) of lib/splat.glsl: 1, u, v
// (gradient by the position), uu, uv, vv (by the covariance); the projection's backward pass goes on from them.
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
layout(binding = 8, std430) readonly buffer ImageGradient { vec4 image_gradient[]; }; // by red, green, blue and alpha

// Sums of a splat; where RESIDUAL, those for responses follow.
const uint SUMS = RESIDUAL ? SLOT_SUMS + SLOT_RESPONSES : SLOT_SUMS;

vec2 centre[PIXELS]; // from the view's origin
float transmittance[PIXELS]; // 0 once the pixel is done
float behind[PIXELS];
vec4 gradient[PIXELS];

float worth(vec4 g, vec4 c) { return RESIDUAL ? dot(g.rgb, c.rgb) : dot(g, c); }

void begin(uint p, uvec2 at) {
    uvec2 size = view[0].size;
    bool inside = all(lessThan(at, size));
    uint pixel = inside ? at.y * size.x + at.x : 0;
    centre[p] = vec2(at) + 0.5 - origin(view[0]);
    transmittance[p] = inside ? 1 : 0;
    gradient[p] = inside ? image_gradient[pixel] : vec4(0);
    behind[p] = worth(gradient[p], image[pixel]);
}

bool done() {
    bool all = true;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) all = all && transmittance[p] <= 0;
    return all;
}

// What a splat is to a pixel: h, T alpha, and alpha; all 0 where the pixel does not draw it.
struct Share { float h, part, alpha; };

bool draws(uint p, float power, float cut) { return power <= cut && transmittance[p] > 0; }

// Blends a splat of this distance into a pixel once more.
Share blend_again(uint p, float power, vec4 shape, vec4 rgb1) {
    float t = transmittance[p];
    float free = exp2(shape.y - power);
    float alpha = min(ALPHA_MAX, free);
    float part = t * alpha;
    float next = t - part; // as in the forward pass
    bool drawn = draws(p, power, shape.z);
    bool live = drawn && next >= STOP;
    float w = live ? part : 0;
    float q = worth(gradient[p], rgb1);
    float r = behind[p] - w * q;
    behind[p] = r;
    float by_alpha = t * q - r / (1 - alpha); // at least 1 - ALPHA_MAX
    transmittance[p] = live ? next : drawn ? 0 : t;
    return Share(live && free < ALPHA_MAX ? alpha * by_alpha : 0, w, live ? alpha : 0);
}
