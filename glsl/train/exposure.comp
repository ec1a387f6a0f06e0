// A photo's own exposure: a 3 x 4 affine map of the rendered colours before the loss, its gradient, and its Adam step.
// Sums run in a fixed order: strided over pixels, a tree within a workgroup, then workgroup after workgroup.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/adam.glsl"

/// Phase: applies the map to the rendered colours.
const uint APPLY = 0;
/// Phase: propagates the gradient back through the map, and sums the gradient by its parameters.
const uint BACKWARD = 1;
/// Phase: updates the parameters, in one workgroup.
const uint UPDATE = 2;
/// Parameters of a photo: three rows of red, green, blue and a constant.
const uint SIZE = 12;

layout(constant_id = 2) const uint PHASE = APPLY;

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 1, std430) readonly buffer Image { vec4 image[]; };
layout(binding = 2, std430) writeonly buffer Exposed { vec4 exposed[]; };
layout(binding = 3, std430) buffer Gradient { vec4 gradient[]; };  // by the exposed colours, then by the rendered ones
layout(binding = 4, std430) buffer Partials { float partials[]; }; // workgroup x 12
layout(binding = 5, std430) buffer Affine { float affine[]; };     // photo x 3 rows x (red, green, blue, constant)
layout(binding = 6, std430) buffer Moments { vec2 moments[]; };    // first and second of each
layout(binding = 7, std430) readonly buffer Gains { float gains[]; }; // photo x (red, green, blue): the measured gains
layout(push_constant) uniform Push {
    uint photo;
    uint pixels;
    uint groups; // workgroups of the backward phase
    uint pair_limit;
    float rate;
    float correction1; // 1 / (1 - beta1^step)
    float correction2; // 1 / sqrt(1 - beta2^step)
    float pull;        // strength of the pull towards the measured gains
};

#include "lib/part_sums.glsl"

void apply() {
    uint p = global_index();
    if (p >= pixels) return;
    vec4 x = image[p];
    vec3 y;
    [[unroll]] for (uint r = 0; r < 3; r++) {
        uint row = SIZE * photo + 4 * r;
        y[r] = affine[row] * x.r + affine[row + 1] * x.g + affine[row + 2] * x.b + affine[row + 3];
    }
    exposed[p] = vec4(y, x.a);
}

void backward() {
    float own[SIZE];
    [[unroll]] for (uint k = 0; k < SIZE; k++) own[k] = 0;
    for (uint p = global_index(); p < pixels; p += groups * WORKGROUP) {
        vec4 x = image[p], g = gradient[p];
        vec3 through = vec3(0);
        [[unroll]] for (uint r = 0; r < 3; r++) {
            uint row = SIZE * photo + 4 * r;
            through += g[r] * vec3(affine[row], affine[row + 1], affine[row + 2]);
            own[4 * r] += g[r] * x.r;
            own[4 * r + 1] += g[r] * x.g;
            own[4 * r + 2] += g[r] * x.b;
            own[4 * r + 3] += g[r];
        }
        gradient[p] = vec4(through, g.a);
    }
    store_part(own);
}

void update() {
    uint lane = gl_LocalInvocationID.x;
    if (lane < SIZE) {
        sums[lane] = sum_of_parts(lane, groups);
    }
    barrier();
    // If pairs did not fit, this iteration does not count.
    if (lane >= SIZE || pairs[1] > pair_limit) return;
    bool good = true;
    for (uint k = 0; k < SIZE; k++) good = good && sane(sums[k]);
    if (!good) return;
    uint at = SIZE * photo + lane;
    float slope = sums[lane];
    vec2 moment = moments[at];
    moment.x = BETA1 * moment.x + (1 - BETA1) * slope;
    moment.y = BETA2 * moment.y + (1 - BETA2) * slope * slope;
    moments[at] = moment;
    float apart = affine[at] - (lane % 5 == 0 ? gains[3 * photo + lane / 5] : 0); // the diagonal has indices 0, 5 and 10
    affine[at] -= rate * ((moment.x * correction1) / (sqrt(moment.y) * correction2 + EPSILON) + pull * apart);
}

void main() {
    if (PHASE == APPLY) apply();
    else if (PHASE == BACKWARD) backward();
    else update();
}
