// Adds one view's eight responses (Q2), of each Gaussian that it shows, to those of earlier views. It reads the
// gradient rows of the projection's backward pass and the slots' sums of the rasterisation's backward pass.
//
// r <- r keep^(views since the last that showed it) + weight x: an average over iterations, or with keep = 1 a mean.
// The SH basis has a constant norm, sum_m Y_lm^2 = (2l + 1) / 4 pi, so |dL/dSH| is |dL/dcolour| times a constant.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/view.glsl"
#include "lib/projection.glsl"
#include "lib/gradient_row.glsl"
#include "lib/responses.glsl"

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 2, std430) readonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 3, std430) readonly buffer FirstSlots { uint first_slots[]; };
layout(binding = 4, std430) readonly buffer ResponseSums { vec4 response_sums[]; }; // by slot: of T alpha, alpha, T alpha times the residual
layout(binding = 5, std430) readonly buffer LogScales { float log_scales[]; };
layout(binding = 6, std430) readonly buffer Rotations { vec4 rotations[]; };
layout(binding = 7, std430) readonly buffer Rows { float rows[]; };
layout(binding = 8, std430) buffer Responses { float responses[]; }; // n x CHANNELS
layout(binding = 9, std430) buffer Seen { uint seen[]; };            // the last iteration that showed it
layout(push_constant) uniform Push {
    uint pair_limit;
    uint iteration;
    float log2_keep;
    float weight;
    float share;      // 1 / pixels
    float basis_norm; // of the SH basis over the bands in use
};

vec3 row3(uint at) { return vec3(rows[at], rows[at + 1], rows[at + 2]); }

void main() {
    uint i = global_index();
    if (pairs[1] > pair_limit || i >= count[0]) return;
    uint slots = tile_counts[i];
    if (slots == 0) return;
    vec3 sums = vec3(0);
    uint first = first_slots[i];
    for (uint slot = first; slot < first + slots; slot++) {
        sums += response_sums[slot].xyz;
    }
    float x[CHANNELS];
    x[0] = sums.x > 0 ? 1 : 0;
    x[1] = sums.x * share;
    x[2] = sums.z * share;
    x[3] = sums.y * share;

    uint row = ROW * i;
    mat3 axes;
    vec4 unit;
    float norm;
    bool good = rows[row + ROW_GOOD] > 0 && rotation_of(rotations[i], axes, unit, norm);
    vec3 scale = exp(ROW3(log_scales, i));
    x[4] = length(scale * (row3(row + ROW_MEAN) * axes));
    x[5] = length(row3(row + ROW_LOG_SCALE));
    x[6] = abs(rows[row + ROW_LOGIT]);
    x[7] = length(row3(row + ROW_COLOUR)) * basis_norm;

    float keep = exp2(log2_keep * float(iteration - seen[i]));
    [[unroll]] for (uint k = 0; k < CHANNELS; k++) {
        bool counts = (k < RENDERING || good) && finite(x[k]);
        responses[CHANNELS * i + k] = keep * responses[CHANNELS * i + k] + (counts ? weight * x[k] : 0);
    }
    seen[i] = iteration;
}
