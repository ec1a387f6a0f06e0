// A step of Adam for one attribute. Every row is updated, whether the view shows it or not, as in the 3DGS reference.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/view.glsl"
#include "lib/sh.glsl"
#include "lib/gradient_row.glsl"
#include "lib/adam_step.glsl"

/// Band of an attribute whose gradient stands in the row itself: no SH band.
const uint NO_BAND = 4;

layout(constant_id = 2) const uint WIDTH = 3;  // elements of a Gaussian
layout(constant_id = 3) const uint OFFSET = 0; // of the attribute in a gradient row
// SH band of the coefficients, or NO_BAND.
layout(constant_id = 4) const uint BAND = NO_BAND;
layout(constant_id = 5) const uint FORM = UPDATE;
// Elements of an invocation: 1, so that neighbouring lanes touch neighbouring words, or WIDTH, one Gaussian's, so that values
// that they share are read once.
layout(constant_id = 6) const uint RUN = 1;
// Whether the attribute, which is then the opacity logits, is under the pressure of an attrition.
layout(constant_id = 7) const bool PRESSED = false;

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Rows { float rows[]; };
layout(binding = 3, std430) buffer Values { float values[]; };
layout(binding = 4, std430) buffer Moments { vec2 moments[]; }; // first and second
layout(push_constant) uniform Push {
    vec2 correction; // see lib/adam_step.glsl
    float rate;
    uint pair_limit;
    float pressure;      // added to every gradient of a logit, over the larger of:
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
    uint first = global_index() * RUN;
    // When pairs did not fit, neither this iteration nor any later one counts until the host has made room.
    if (pairs[1] > pair_limit || first >= count[0] * WIDTH) return;
    uint row = first / WIDTH * ROW;
    if (rows[row + ROW_GOOD] == 0) return;
    vec3 colour = vec3(0), direction = vec3(0);
    if (BAND < NO_BAND) {
        colour = vec3(rows[row + ROW_COLOUR], rows[row + ROW_COLOUR + 1], rows[row + ROW_COLOUR + 2]);
        if (BAND > 0) direction = vec3(rows[row + ROW_DIRECTION], rows[row + ROW_DIRECTION + 1], rows[row + ROW_DIRECTION + 2]);
    }
    // One step takes the channels of one coefficient, or all elements of another attribute.
    const uint STEP = BAND == NO_BAND ? RUN : min(RUN, 3);
    [[dont_unroll]] for (uint step = 0; step < RUN; step += STEP) {
        [[unroll]] for (uint k = 0; k < STEP; k++) {
            uint at = first + step + k, c = RUN == 1 ? at % WIDTH : step + k, channel = RUN == 1 ? c % 3 : k;
            float gradient = BAND == NO_BAND ? rows[row + OFFSET + c] : basis(c / 3, direction) * colour[channel];
            if (FORM == GRADIENT) {
                moments[at] = vec2(gradient, 0);
                continue;
            }
            if (PRESSED) gradient += pressed(values[at], pressure, least_through);
            vec2 moment = next_moments(moments[at], gradient);
            moments[at] = moment;
            values[at] -= change(moment, rate, correction);
        }
    }
}
