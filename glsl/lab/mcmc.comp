// Growth by relocation (3DGS as MCMC, Kheradmand et al. 2024). Before Adam, REGULARISE adds the slopes of the mean
// opacity and of the mean scale to the rows of gradients. After it, NOISE moves faint Gaussians at random, in
// proportion to their own covariance, so that they explore; opaque ones stay.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/view.glsl"
#include "lib/projection.glsl"
#include "lib/random.glsl"
#include "lib/gradient_row.glsl"

/// Phase: adds slopes of opacities and scales to gradients.
const uint REGULARISE = 0;
/// Phase: moves faint Gaussians.
const uint NOISE = 1;
/// Steepness of the logistic function by which noise falls with the opacity.
const float STEEPNESS = 100.0;
/// Opacity at which the noise is half: 1 - 0.995.
const float HALF_MOVED = 0.005;

layout(constant_id = 2) const uint PHASE = REGULARISE;

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Logits { float logits[]; };
layout(binding = 3, std430) readonly buffer LogScales { float log_scales[]; };
layout(binding = 4, std430) readonly buffer Rotations { vec4 rotations[]; };
layout(binding = 5, std430) buffer Rows { float rows[]; };
layout(binding = 6, std430) buffer Means { float means[]; };
layout(push_constant) uniform Push {
    uint pair_limit;
    uint seed;
    uint iteration;
    float opacity; // REGULARISE: weight of the sum of opacities
    float scale;   // REGULARISE: weight of the sum of scales
    float noise;   // NOISE: factor of the noise, per world unit
};

void main() {
    uint i = global_index();
    // If pairs did not fit, no iteration counts, from this one until the host has made room.
    if (pairs[1] > pair_limit || i >= count[0]) return;
    float shown = 1 / (1 + exp(-logits[i]));
    vec3 scales = exp(ROW3(log_scales, i));
    if (PHASE == REGULARISE) {
        uint row = i * ROW;
        rows[row + ROW_LOGIT] += opacity * shown * (1 - shown);
        [[unroll]] for (uint c = 0; c < 3; c++) rows[row + ROW_LOG_SCALE + c] += scale * scales[c];
        return;
    }
    mat3 rotation;
    vec4 unit;
    float norm;
    if (nan(logits[i]) || !finite(scales) || !rotation_of(rotations[i], rotation, unit, norm)) return;
    vec3 draw = vec3(normals(uvec4(seed, iteration, i, 2)), normals(uvec4(seed, iteration, i, 3)).x);
    float share = 1 / (1 + exp(STEEPNESS * (shown - HALF_MOVED)));
    vec3 step = noise * share * (rotation * (scales * scales * (draw * rotation)));
    if (!finite(step)) return;
    [[unroll]] for (uint c = 0; c < 3; c++) means[3 * i + c] += step[c];
}
