// A pixel's part in the backward pass of the rasterisation, shared by both ways of walking a tile's list.
//
// With q = dL/dC . c and R the part of dL/dC . C that lies behind, dL/dalpha = T q - R / (1 - alpha): each pixel carries one scalar
// instead of three. With h = alpha dL/dalpha the sums are the moments of h over (u, v) of lib/splat.glsl: 1, u, v (gradient by the
// position), uu, uv, vv (by the covariance); the projection's backward pass continues from them.
#include "lib/tile_pixels.glsl"

layout(binding = 8, std430) readonly buffer ImageGradient { vec4 image_gradient[]; }; // by red, green, blue and alpha

// Sums of a splat; if RESIDUAL, followed by those for responses.
const uint SUMS = RESIDUAL ? SLOT_SUMS + SLOT_RESPONSES : SLOT_SUMS;

float behind[PIXELS];
vec4 gradient[PIXELS];

float worth(vec4 g, vec4 c) { return RESIDUAL ? dot(g.rgb, c.rgb) : dot(g, c); }

void begin(uint p, uvec2 at) {
    int pixel = place(p, at);
    gradient[p] = pixel >= 0 ? image_gradient[pixel] : vec4(0);
    behind[p] = worth(gradient[p], image[max(pixel, 0)]);
}

// A splat's share in a pixel: h, T alpha, and alpha; all 0 if the pixel does not draw it.
struct Share { float h, part, alpha; };

bool draws(uint p, float power, float cut) {
    float t = transmittance[p];
    return power <= cut && t > 0;
}

// Blends a splat of this distance into a pixel again.
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
    float by_alpha = t * q - r / (1 - alpha); // the divisor is at least 1 - ALPHA_MAX
    transmittance[p] = live ? next : drawn ? 0 : t;
    return Share(live && free < ALPHA_MAX ? alpha * by_alpha : 0, w, live ? alpha : 0);
}
