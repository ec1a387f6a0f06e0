// A step of Adam for one attribute, one element per invocation. Every row is updated, whether the view shows it or not,
// as in the 3DGS reference.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/view.glsl"
#include "lib/sh.glsl"
#include "lib/gradient_row.glsl"
#include "lib/adam_step.glsl"

/// Band of an attribute whose gradient is in the row itself: not an SH band.
const uint NO_BAND = 4;

layout(constant_id = 2) const uint WIDTH = 3;  // elements per Gaussian
layout(constant_id = 3) const uint OFFSET = 0; // of the attribute in a gradient row
// SH band of the coefficients, or NO_BAND.
layout(constant_id = 4) const uint BAND = NO_BAND;
layout(constant_id = 5) const uint FORM = UPDATE;
// True if the attribute is the opacity logits, under the pressure of an attrition.
layout(constant_id = 6) const bool PRESSED = false;

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Rows { float rows[]; };
layout(binding = 3, std430) buffer Values { float values[]; };
layout(binding = 4, std430) buffer Moments { vec2 moments[]; }; // first and second
layout(push_constant) uniform Push {
    vec4 decays; // see lib/adam_step.glsl
    vec2 correction;
    float rate;
    uint pair_limit;
    float pressure;      // added to every gradient of a logit, divided by the larger of:
    float least_through; // this and 1 - opacity
};

float basis(uint m, vec3 d) {
    float value = SH_C0;
    if (BAND == 1) {
        float b[3];
        sh_basis_1(d, b);
        [[unroll]] for (uint k = 0; k < 3; k++) value = m == k ? b[k] : value;
    } else if (BAND == 2) {
        float b[5];
        sh_basis_2(d, b);
        [[unroll]] for (uint k = 0; k < 5; k++) value = m == k ? b[k] : value;
    } else if (BAND == 3) {
        float b[7];
        sh_basis_3(d, b);
        [[unroll]] for (uint k = 0; k < 7; k++) value = m == k ? b[k] : value;
    }
    return value;
}

void main() {
    uint at = global_index();
    // If pairs did not fit, no iteration counts, from this one until the host has made room.
    if (pairs[1] > pair_limit || at >= count[0] * WIDTH) return;
    uint row = at / WIDTH * ROW, c = at % WIDTH;
    if (rows[row + ROW_GOOD] == 0) return;
    float gradient;
    if (BAND == NO_BAND) {
        gradient = rows[row + OFFSET + c];
    } else {
        vec3 direction = vec3(rows[row + ROW_DIRECTION], rows[row + ROW_DIRECTION + 1], rows[row + ROW_DIRECTION + 2]);
        gradient = basis(c / 3, direction) * rows[row + ROW_COLOUR + c % 3];
    }
    if (FORM == GRADIENT) {
        moments[at] = vec2(gradient, 0);
        return;
    }
    if (PRESSED) gradient += pressed(values[at], pressure, least_through);
    vec2 moment = next_moments(moments[at], gradient, decays);
    moments[at] = moment;
    values[at] -= change(moment, rate, correction);
}
