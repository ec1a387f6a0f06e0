// Rotation and floored, dilated scales of each Gaussian of a batch, computed once for all of its pairs.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/view.glsl"
#include "lib/projection.glsl"
#include "lib/axes.glsl"

layout(binding = 0, std430) readonly buffer Members { uint members[]; }; // Gaussians by block
layout(binding = 1, std430) readonly buffer Means { float means[]; };
layout(binding = 2, std430) readonly buffer LogScales { float log_scales[]; };
layout(binding = 3, std430) readonly buffer Rotations { vec4 rotations[]; };
layout(binding = 4, std430) writeonly buffer AxesRows { vec4 axes[]; }; // four for each member of the batch: lib/axes.glsl
layout(push_constant) uniform Push {
    uint first;         // member at which the batch begins
    uint count;
    float log_dilation; // ln of the standard deviation added to each axis in quadrature; very negative for none
    float least;        // share of the largest scale to which the others are raised
};

/// Logarithm to which scales are clamped: e^69 is 2^99.5, so 2 to the difference of two exponents is still a float.
const float LARGEST_LOG = 69.0;
// ln 2 in two parts, the first with so few bits that its product with an exponent is exact.
const float LN_2_HIGH = 0.693359375;
const float LN_2_LOW = -2.1219444005469057e-4;

// exp(x) / 2^e, as exact for x near e ln 2 as exp is near 0.
float scaled_exp(float x, float e) {
    precise float high = x - e * LN_2_HIGH;
    return exp(high - e * LN_2_LOW);
}

void main() {
    uint n = global_index();
    if (n >= count) return;
    uint i = members[first + n];
    vec3 logs = ROW3(log_scales, i);
    mat3 r;
    vec4 unit;
    float norm;
    if (!rotation_of(rotations[i], r, unit, norm)) r = mat3(1);
    [[unroll]] for (uint k = 0; k < 3; k++) {
        // A NaN scale counts as the smallest.
        logs[k] = nan(logs[k]) ? -LARGEST_LOG : clamp(logs[k], -LARGEST_LOG, LARGEST_LOG);
    }
    // Sorts by three exchanges.
    if (logs.x < logs.y) { logs.xy = logs.yx; vec3 t = r[0]; r[0] = r[1]; r[1] = t; }
    if (logs.y < logs.z) { logs.yz = logs.zy; vec3 t = r[1]; r[1] = r[2]; r[2] = t; }
    if (logs.x < logs.y) { logs.xy = logs.yx; vec3 t = r[0]; r[0] = r[1]; r[1] = t; }

    float e = round(max(logs.x, log_dilation) * LOG2_E);
    vec3 scale;
    [[unroll]] for (uint k = 0; k < 3; k++) scale[k] = scaled_exp(logs[k], e);
    if (log_dilation > -LARGEST_LOG) {
        float t = scaled_exp(log_dilation, e);
        scale = sqrt(scale * scale + t * t);
    }
    scale = max(scale, vec3(least * scale.x));
    Axes a = Axes(r, scale, ROW3(means, i), int(e));
    mat4 rows = pack_axes(a);
    [[unroll]] for (uint k = 0; k < 4; k++) axes[4 * n + k] = rows[k];
}
