// Scores of each splat in a picture, tile by tile: for each slot sums over the tile's pixels, which tally.comp adds up
// by Gaussian. One subgroup walks a tile front to back.
//
// Removing a splat exactly changes a pixel by -phi, phi = T alpha (c - b), where b is the colour behind it, which is then seen
// through T instead of T (1 - alpha). With R the part of the picture that lies behind, T alpha b = R alpha / (1 - alpha).
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/tile_pixels.glsl"

layout(constant_id = 5) const bool RESIDUAL = false; // true if the residual's colours are used

layout(binding = 8, std430) readonly buffer Residual { vec4 residual[]; };
// By slot, w = T alpha: the sum of w, the largest w, the pixels that blend the splat, the sum of opacity x T;
layout(binding = 9, std430) writeonly buffer Weights { vec4 weights[]; };
// the sums of w^2, of |phi|^2, of phi . residual, and 0; and the sum of w b, and 0.
layout(binding = 10, std430) writeonly buffer Changes { vec4 changes[]; };
layout(binding = 11, std430) writeonly buffer Behinds { vec4 behinds[]; };

vec3 behind[PIXELS];
vec3 off[PIXELS];
vec4 own_weights, own_changes, own_behind;

#include "lib/tile_walk.glsl"

void begin(uint p, uvec2 at) {
    int pixel = place(p, at);
    behind[p] = image[max(pixel, 0)].rgb;
    off[p] = RESIDUAL ? residual[max(pixel, 0)].rgb : vec3(0);
}

void forget() { own_weights = own_changes = own_behind = vec4(0); }

void visit(uint n, vec4 g, vec4 s, vec2 c) {
    vec3 rgb = vec3(s.w, c);
    float opacity = exp2(s.y);
    vec4 weight = vec4(0), change = vec4(0), through = vec4(0);
    float most = 0;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        vec2 d = centre[p] - g.xy;
        float u = g.z * d.x + g.w * d.y;
        float v = s.x * d.y;
        float power = u * u + v * v;
        float t = transmittance[p];
        float alpha = min(ALPHA_MAX, exp2(s.y - power));
        float part = t * alpha;
        float next = t - part; // as in the forward pass
        bool drawn = power <= s.z && t > 0;
        bool live = drawn && next >= STOP;
        float w = live ? part : 0;
        vec3 r = behind[p] - w * rgb;
        vec3 seen_behind = live ? r * (alpha / (1 - alpha)) : vec3(0); // the divisor is at least 1 - ALPHA_MAX
        vec3 phi = w * rgb - seen_behind;
        weight += live ? vec4(w, 0, 1, opacity * t) : vec4(0);
        most = max(most, w);
        change += vec4(w * w, dot(phi, phi), RESIDUAL ? dot(phi, off[p]) : 0, 0);
        through += vec4(seen_behind, 0);
        behind[p] = r;
        transmittance[p] = live ? next : drawn ? 0 : t;
    }
    weight = lane_sum(weight);
    weight.y = subgroupMax(most);
    change = lane_sum(change);
    through = lane_sum(through);
    bool own = gl_SubgroupInvocationID == n;
    own_weights = own ? weight : own_weights;
    own_changes = own ? change : own_changes;
    own_behind = own ? through : own_behind;
}

void hand_in_own(uint slot, uint gaussian) {
    weights[slot] = own_weights;
    changes[slot] = own_changes;
    behinds[slot] = own_behind;
}

void hand_in_nothing(uint slot) { weights[slot] = changes[slot] = behinds[slot] = vec4(0); }

void main() { walk_own_tile(); }
