// Adam on one attribute. Every row is updated, seen or not, as the reference does.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/view.glsl"
#include "lib/sh.glsl"
#include "lib/gradient_row.glsl"

layout(constant_id = 2) const uint WIDTH = 3;  // elements a Gaussian
layout(constant_id = 3) const uint OFFSET = 0; // of the attribute in a gradient row
// SH band whose coefficients these are; 4 where the row holds the gradient itself.
layout(constant_id = 4) const uint BAND = 4;
// 0 updates; 1 writes the gradient into the first moment instead (tests)
layout(constant_id = 5) const uint FORM = 0;
// Elements an invocation owns: 1, so that neighbouring lanes touch neighbouring words; or WIDTH, a Gaussian's, so that what
// they share is read once.
layout(constant_id = 6) const uint RUN = 1;

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the most ever needed
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Rows { float rows[]; };
layout(binding = 3, std430) buffer Values { float values[]; };
layout(binding = 4, std430) buffer Moments { vec2 moments[]; }; // first and second
layout(push_constant) uniform Push {
    float rate;
    float correction1; // 1 / (1 - beta1^step)
    float correction2; // 1 / sqrt(1 - beta2^step)
    uint pair_limit;
};

const float BETA1 = 0.9;
const float BETA2 = 0.999;
const float EPSILON = 1e-15;

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
    // Pairs that did not fit: this iteration does not count, nor does any after it until the host has made room.
    if (pairs[1] > pair_limit || first >= count[0] * WIDTH) return;
    uint row = first / WIDTH * ROW;
    if (rows[row + ROW_GOOD] == 0) return;
    vec3 colour = vec3(0), direction = vec3(0);
    if (BAND < 4) {
        colour = vec3(rows[row + ROW_COLOUR], rows[row + ROW_COLOUR + 1], rows[row + ROW_COLOUR + 2]);
        if (BAND > 0) direction = vec3(rows[row + ROW_DIRECTION], rows[row + ROW_DIRECTION + 1], rows[row + ROW_DIRECTION + 2]);
    }
    // One step is a coefficient's channels, or all of another attribute.
    const uint STEP = BAND == 4 ? RUN : min(RUN, 3);
    [[dont_unroll]] for (uint step = 0; step < RUN; step += STEP) {
        [[unroll]] for (uint k = 0; k < STEP; k++) {
            uint at = first + step + k, c = RUN == 1 ? at % WIDTH : step + k, channel = RUN == 1 ? c % 3 : k;
            float gradient = BAND == 4 ? rows[row + OFFSET + c] : basis(c / 3, direction) * colour[channel];
            if (FORM == 1) {
                moments[at] = vec2(gradient, 0);
                continue;
            }
            vec2 moment = moments[at];
            moment.x = BETA1 * moment.x + (1 - BETA1) * gradient;
            moment.y = BETA2 * moment.y + (1 - BETA2) * gradient * gradient;
            moments[at] = moment;
            values[at] -= rate * (moment.x * correction1) / (sqrt(moment.y) * correction2 + EPSILON);
        }
    }
}
