// Density control, last step: the halves of a split move to random points of their parent, 1.6 times smaller. With
// LENGTHWISE they share its longest axis instead: each lies in one half of it, correspondingly shorter, and fainter.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/view.glsl"
#include "lib/projection.glsl"
#include "lib/random.glsl"
#include "lib/density.glsl"

layout(constant_id = 2) const bool LENGTHWISE = false;

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Kinds { uint kinds[]; };
layout(binding = 2, std430) readonly buffer Rotations { vec4 rotations[]; };
layout(binding = 3, std430) buffer Means { float means[]; };
layout(binding = 4, std430) buffer LogScales { float log_scales[]; };
layout(binding = 5, std430) buffer Logits { float logits[]; };
layout(push_constant) uniform Push { uint seed; uint iteration; };

void main() {
    uint row = global_index();
    if (row >= count[0] || kinds[row] < HALF) return;
    mat3 rotation;
    vec4 unit;
    float norm;
    if (!rotation_of(rotations[row], rotation, unit, norm)) rotation = mat3(1);
    vec3 log_scale = ROW3(log_scales, row);
    vec3 place, shrink = vec3(LN_SHRINK);
    if (LENGTHWISE) {
        // The first among equal axes.
        uint longest = log_scale.x >= log_scale.y && log_scale.x >= log_scale.z ? 0 : log_scale.y >= log_scale.z ? 1 : 2;
        place = vec3(0);
        place[longest] = kinds[row] == HALF ? HALF_APART : -HALF_APART;
        shrink = vec3(LN_THINNER);
        shrink[longest] = LN_SHORTER;
        // The logit of HALF_OPACITY times the opacity.
        logits[row] = -log((1 + exp(-logits[row]) - HALF_OPACITY) / HALF_OPACITY);
    } else {
        place = vec3(normals(uvec4(seed, iteration, row, 0)), normals(uvec4(seed, iteration, row, 1)).x);
    }
    vec3 offset = rotation * (exp(log_scale) * place);
    for (uint c = 0; c < 3; c++) {
        means[3 * row + c] += offset[c];
        log_scales[3 * row + c] = log_scale[c] - shrink[c];
    }
}
