// Gradients by the masks, masked Gaussians included: for each slot a sum over the tile's pixels. One subgroup walks a
// tile front to back.
//
// With mask M, a splat has the opacity M alpha in a pixel C = sum of M c T alpha, so dL/dM = T alpha dL/dC . (c - b), b the colour
// behind. With R, the part of dL/dC . C that lies behind, T b is R if the splat is masked, otherwise R / (1 - alpha).
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/tile_pixels.glsl"

layout(constant_id = 5) const bool COLOURS = false; // true if the image gradient's fourth component is not a gradient by alpha

layout(binding = 8, std430) readonly buffer ImageGradient { vec4 image_gradient[]; }; // by red, green, blue and alpha
layout(binding = 9, std430) writeonly buffer Sums { float sums[]; }; // by slot

float behind[PIXELS];
vec4 gradient[PIXELS];
float own_sum;

#include "lib/tile_walk.glsl"

void begin(uint p, uvec2 at) {
    int pixel = place(p, at);
    gradient[p] = pixel >= 0 ? image_gradient[pixel] : vec4(0);
    if (COLOURS) gradient[p].a = 0;
    behind[p] = dot(gradient[p], image[max(pixel, 0)]);
}

void forget() { own_sum = 0; }

// The shape is the one after learnt_mask.comp, in which a masked splat has a negative cut.
void visit(uint n, vec4 g, vec4 s, vec2 c) {
    vec4 rgb1 = vec4(s.w, c, 1);
    bool masked = s.z < 0;
    float sum = 0;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        vec2 d = centre[p] - g.xy;
        float u = g.z * d.x + g.w * d.y;
        float v = s.x * d.y;
        float power = u * u + v * v;
        float t = transmittance[p];
        float alpha = min(ALPHA_MAX, exp2(s.y - power));
        float part = t * alpha;
        float next = t - part; // as in the forward pass
        bool drawn = power <= abs(s.z) && t > 0;
        bool live = drawn && !masked && next >= STOP;
        float q = dot(gradient[p], rgb1);
        float r = behind[p] - (live ? part * q : 0);
        bool counts = drawn && (masked || live);
        sum += counts ? part * q - r * (masked ? alpha : alpha / (1 - alpha)) : 0; // the divisor is at least 1 - ALPHA_MAX
        behind[p] = r;
        transmittance[p] = live ? next : drawn && !masked ? 0 : t;
    }
    sum = lane_sum(vec3(sum, 0, 0)).x;
    own_sum = gl_SubgroupInvocationID == n ? sum : own_sum;
}

void hand_in_own(uint slot, uint gaussian) { sums[slot] = own_sum; }

void hand_in_nothing(uint slot) { sums[slot] = 0; }

void main() { walk_own_tile(); }
