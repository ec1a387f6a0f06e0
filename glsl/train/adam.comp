// A step of Adam for all attributes at once. A workgroup reads the rows of gradients of a block of Gaussians once, into shared
// memory, and updates the attributes one by one, neighbouring words by neighbouring invocations; or each invocation updates all
// elements of one Gaussian. Every row is updated, whether the view shows it or not, as in the 3DGS reference.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/sh.glsl"
#include "lib/gradient_row.glsl"
#include "lib/adam_step.glsl"

layout(constant_id = 2) const uint BLOCK = 64; // Gaussians per workgroup; 1: one per invocation
layout(constant_id = 3) const uint DEGREE = 3; // bands with arrays
layout(constant_id = 4) const uint FORM = UPDATE;
layout(constant_id = 5) const bool PRESSED = false; // true if the logits are under the pressure of an attrition

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Rows { float rows[]; };
layout(binding = 3, std430) buffer Means { float means[]; };
layout(binding = 4, std430) buffer LogScales { float log_scales[]; };
layout(binding = 5, std430) buffer Rotations { float rotations[]; };
layout(binding = 6, std430) buffer Logits { float logits[]; };
layout(binding = 7, std430) buffer Sh0 { float sh0[]; };
layout(binding = 8, std430) buffer Sh1 { float sh1[]; };
layout(binding = 9, std430) buffer Sh2 { float sh2[]; };
layout(binding = 10, std430) buffer Sh3 { float sh3[]; };
// First and second moments.
layout(binding = 11, std430) buffer MeanMoments { vec2 mean_moments[]; };
layout(binding = 12, std430) buffer LogScaleMoments { vec2 log_scale_moments[]; };
layout(binding = 13, std430) buffer RotationMoments { vec2 rotation_moments[]; };
layout(binding = 14, std430) buffer LogitMoments { vec2 logit_moments[]; };
layout(binding = 15, std430) buffer Sh0Moments { vec2 sh0_moments[]; };
layout(binding = 16, std430) buffer Sh1Moments { vec2 sh1_moments[]; };
layout(binding = 17, std430) buffer Sh2Moments { vec2 sh2_moments[]; };
layout(binding = 18, std430) buffer Sh3Moments { vec2 sh3_moments[]; };
layout(push_constant) uniform Push {
    vec4 decays; // see lib/adam_step.glsl
    vec2 correction;
    uint pair_limit;
    float pressure;
    float least_through;
    float rate_means;
    float rate_log_scales;
    float rate_rotations;
    float rate_logits;
    float rate_sh0;
    float rate_sh1;
    float rate_sh2;
    float rate_sh3;
};

const uint COEFFICIENTS = (DEGREE + 1) * (DEGREE + 1);
shared float block_rows[BLOCK * ROW];
shared float block_basis[BLOCK * COEFFICIENTS];

float gradient_in_row(uint g, uint at) { return block_rows[ROW * g + at]; }

// Gradient by element c of the band that begins with coefficient `first`.
float gradient_of_sh(uint g, uint first, uint c) {
    return block_basis[COEFFICIENTS * g + first + c / 3] * block_rows[ROW * g + ROW_COLOUR + c % 3];
}

void store_basis(uint g) {
    uint at = COEFFICIENTS * g, row = ROW * g + ROW_DIRECTION;
    vec3 d = vec3(block_rows[row], block_rows[row + 1], block_rows[row + 2]);
    block_basis[at] = SH_C0;
    float one[3], two[5], three[7];
    if (DEGREE > 0) {
        sh_basis_1(d, one);
        [[unroll]] for (uint m = 0; m < 3; m++) block_basis[at + 1 + m] = one[m];
    }
    if (DEGREE > 1) {
        sh_basis_2(d, two);
        [[unroll]] for (uint m = 0; m < 5; m++) block_basis[at + 4 + m] = two[m];
    }
    if (DEGREE > 2) {
        sh_basis_3(d, three);
        [[unroll]] for (uint m = 0; m < 7; m++) block_basis[at + 9 + m] = three[m];
    }
}

// Element `at` of an attribute; `extra` is added to its gradient.
#define UPDATE_ELEMENT(values, moments, rate, gradient, extra)                                  \
    if (FORM == GRADIENT) {                                                                     \
        moments[at] = vec2(gradient, 0);                                                        \
    } else {                                                                                    \
        vec2 moment = next_moments(moments[at], gradient + (extra), decays);                    \
        moments[at] = moment;                                                                   \
        values[at] -= change(moment, rate, correction);                                         \
    }

// Elements that an invocation of a block updates at a time: it loads all of them before it waits for the first.
const uint HELD = 4;

// All elements of an attribute of the block's Gaussians. Surplus invocations repeat the last element and do not store.
#define UPDATE_ATTRIBUTE(values, moments, width, rate, gradient, extra)                         \
    [[dont_unroll]] for (uint start = invocation; start < here * width; start += HELD * WORKGROUP) { \
        vec2 moment[HELD];                                                                      \
        float value[HELD];                                                                      \
        [[unroll]] for (uint k = 0; k < HELD; k++) {                                            \
            uint at = first * width + min(start + k * WORKGROUP, here * width - 1);             \
            moment[k] = moments[at];                                                            \
            value[k] = values[at];                                                              \
        }                                                                                       \
        [[unroll]] for (uint k = 0; k < HELD; k++) {                                            \
            uint e = min(start + k * WORKGROUP, here * width - 1);                              \
            uint g = e / width, c = e % width, at = first * width + e;                          \
            float held = value[k], by = (gradient) + (extra);                                   \
            vec2 next = FORM == GRADIENT ? vec2(by, 0) : next_moments(moment[k], by, decays);   \
            if (FORM != GRADIENT) held -= change(next, rate, correction);                       \
            if (start + k * WORKGROUP < here * width && block_rows[ROW * g + ROW_GOOD] != 0) {  \
                moments[at] = next;                                                             \
                values[at] = held;                                                              \
            }                                                                                   \
        }                                                                                       \
    }

void update_block(uint first) {
    uint invocation = gl_LocalInvocationID.x, here = min(BLOCK, count[0] - first);
    for (uint e = invocation; e < here * ROW; e += WORKGROUP) block_rows[e] = rows[first * ROW + e];
    barrier();
    for (uint g = invocation; g < here; g += WORKGROUP) store_basis(g);
    barrier();
    UPDATE_ATTRIBUTE(means, mean_moments, 3, rate_means, gradient_in_row(g, ROW_MEAN + c), 0)
    UPDATE_ATTRIBUTE(log_scales, log_scale_moments, 3, rate_log_scales, gradient_in_row(g, ROW_LOG_SCALE + c), 0)
    UPDATE_ATTRIBUTE(rotations, rotation_moments, 4, rate_rotations, gradient_in_row(g, ROW_ROTATION + c), 0)
    UPDATE_ATTRIBUTE(logits, logit_moments, 1, rate_logits, gradient_in_row(g, ROW_LOGIT),
                     PRESSED ? pressed(held, pressure, least_through) : 0)
    UPDATE_ATTRIBUTE(sh0, sh0_moments, 3, rate_sh0, gradient_of_sh(g, 0, c), 0)
    if (DEGREE > 0) UPDATE_ATTRIBUTE(sh1, sh1_moments, 9, rate_sh1, gradient_of_sh(g, 1, c), 0)
    if (DEGREE > 1) UPDATE_ATTRIBUTE(sh2, sh2_moments, 15, rate_sh2, gradient_of_sh(g, 4, c), 0)
    if (DEGREE > 2) UPDATE_ATTRIBUTE(sh3, sh3_moments, 21, rate_sh3, gradient_of_sh(g, 9, c), 0)
}

// All elements of an attribute of Gaussian `g`.
#define UPDATE_OWN(values, moments, width, rate, offset, extra)                                 \
    [[dont_unroll]] for (uint c = 0; c < width; c++) {                                          \
        uint at = width * g + c;                                                                \
        UPDATE_ELEMENT(values, moments, rate, rows[row + offset + c], extra)                    \
    }

// All elements of a band of Gaussian `g`.
#define UPDATE_OWN_BAND(values, moments, coefficients, basis, rate)                             \
    [[dont_unroll]] for (uint m = 0; m < coefficients; m++) {                                   \
        float value = basis[0];                                                                 \
        [[unroll]] for (uint k = 1; k < coefficients; k++) value = m == k ? basis[k] : value;   \
        [[dont_unroll]] for (uint k = 0; k < 3; k++) {                                          \
            uint at = 3 * (coefficients * g + m) + k;                                           \
            float of_channel = k == 0 ? colour.x : k == 1 ? colour.y : colour.z;                \
            UPDATE_ELEMENT(values, moments, rate, value * of_channel, 0)                        \
        }                                                                                       \
    }

void update_own(uint g) {
    uint row = ROW * g;
    if (rows[row + ROW_GOOD] == 0) return;
    UPDATE_OWN(means, mean_moments, 3, rate_means, ROW_MEAN, 0)
    UPDATE_OWN(log_scales, log_scale_moments, 3, rate_log_scales, ROW_LOG_SCALE, 0)
    UPDATE_OWN(rotations, rotation_moments, 4, rate_rotations, ROW_ROTATION, 0)
    UPDATE_OWN(logits, logit_moments, 1, rate_logits, ROW_LOGIT, PRESSED ? pressed(logits[at], pressure, least_through) : 0)
    vec3 colour = vec3(rows[row + ROW_COLOUR], rows[row + ROW_COLOUR + 1], rows[row + ROW_COLOUR + 2]);
    vec3 d = vec3(rows[row + ROW_DIRECTION], rows[row + ROW_DIRECTION + 1], rows[row + ROW_DIRECTION + 2]);
    float none[1] = float[](SH_C0), one[3], two[5], three[7];
    UPDATE_OWN_BAND(sh0, sh0_moments, 1, none, rate_sh0)
    if (DEGREE > 0) {
        sh_basis_1(d, one);
        UPDATE_OWN_BAND(sh1, sh1_moments, 3, one, rate_sh1)
    }
    if (DEGREE > 1) {
        sh_basis_2(d, two);
        UPDATE_OWN_BAND(sh2, sh2_moments, 5, two, rate_sh2)
    }
    if (DEGREE > 2) {
        sh_basis_3(d, three);
        UPDATE_OWN_BAND(sh3, sh3_moments, 7, three, rate_sh3)
    }
}

void main() {
    uint first = BLOCK == 1 ? global_index() : group_index() * BLOCK;
    // If pairs did not fit, no iteration counts, from this one until the host has made room.
    if (pairs[1] > pair_limit || first >= count[0]) return;
    if (BLOCK == 1) update_own(first);
    else update_block(first);
}
