// Density control, last step: the halves of a split move to random points of their parent, 1.6 times smaller.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/view.glsl"
#include "lib/projection.glsl"
#include "lib/random.glsl"
#include "lib/density.glsl"

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Kinds { uint kinds[]; };
layout(binding = 2, std430) readonly buffer Rotations { vec4 rotations[]; };
layout(binding = 3, std430) buffer Means { float means[]; };
layout(binding = 4, std430) buffer LogScales { float log_scales[]; };
layout(push_constant) uniform Push { uint seed; uint iteration; };

void main() {
    uint row = global_index();
    if (row >= count[0] || kinds[row] != HALF) return;
    vec3 n = vec3(normals(uvec4(seed, iteration, row, 0)), normals(uvec4(seed, iteration, row, 1)).x);
    mat3 rotation;
    vec4 unit;
    float norm;
    if (!rotation_of(rotations[row], rotation, unit, norm)) rotation = mat3(1);
    vec3 log_scale = vec3(log_scales[3 * row], log_scales[3 * row + 1], log_scales[3 * row + 2]);
    vec3 offset = rotation * (exp(log_scale) * n);
    for (uint c = 0; c < 3; c++) {
        means[3 * row + c] += offset[c];
        log_scales[3 * row + c] = log_scale[c] - LN_SHRINK;
    }
}
