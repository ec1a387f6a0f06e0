// A step of Adam for the scores of learnt masks, after the backward pass. A mask is 0 or 1 in the picture; for the
// gradient, it changes with its score like the sigmoid that it rounds (straight through).
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/learnt_mask.glsl"
#include "lib/gradient_row.glsl"
#include "lib/adam_step.glsl"

/// Larger logits count as this one, so that e to its power is finite.
const float GREATEST_LOGIT = 80.0;

layout(constant_id = 2) const bool SAMPLED = false; // true if masks are drawn at random; otherwise a threshold decides

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 3, std430) readonly buffer FirstSlots { uint first_slots[]; };
layout(binding = 4, std430) readonly buffer Sums { float sums[]; }; // by slot, from learnt_mask_gradient.comp; only if SAMPLED
layout(binding = 5, std430) readonly buffer Rows { float rows[]; };
layout(binding = 6, std430) readonly buffer Logits { float logits[]; };
layout(binding = 7, std430) readonly buffer Shown { uint shown[]; };
layout(binding = 8, std430) buffer Scores { float scores[]; };
layout(binding = 9, std430) buffer Moments { vec2 moments[]; }; // first and second
layout(push_constant) uniform Push {
    vec2 correction; // see lib/adam_step.glsl
    float rate;
    float weight; // of the masks' mean in the loss; if SAMPLED, of its square
    uint pair_limit;
    uint seed;
    uint iteration;
};

// The mask multiplies scales and opacity: its slope at 1 is the slope by the logarithms of all four.
float slope_of_row(uint i) {
    uint row = i * ROW;
    float sum = rows[row + ROW_LOGIT] * (1 + exp(min(logits[i], GREATEST_LOGIT)));
    [[unroll]] for (uint c = 0; c < 3; c++) sum += rows[row + ROW_LOG_SCALE + c];
    return sum;
}

float slope_of_slots(uint i) {
    float sum = 0;
    uint first = first_slots[i], slots = tile_counts[i];
    for (uint slot = first; slot < first + slots; slot++) sum += sums[slot];
    return sum;
}

void main() {
    uint i = global_index();
    // If pairs did not fit, no iteration counts, from this one until the host has made room.
    if (pairs[1] > pair_limit || i >= count[0] || rows[i * ROW + ROW_GOOD] == 0) return;
    float n = float(count[0]);
    float slope, soft = scores[i];
    if (SAMPLED) {
        slope = slope_of_slots(i) + 2 * weight * (float(shown[0]) / n) / n;
        soft += logistic(uvec3(seed, iteration, i));
    } else {
        slope = slope_of_row(i) + weight / n;
    }
    float gradient = slope * slope_of_mask(soft);
    if (!sane(gradient)) return;
    vec2 moment = next_moments(moments[i], gradient, vec4(BETA1, 1 - BETA1, BETA2, 1 - BETA2));
    moments[i] = moment;
    scores[i] -= change(moment, rate, correction);
}
