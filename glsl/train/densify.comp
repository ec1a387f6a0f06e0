// Density control, first step: the number of copies of each Gaussian: 0 if pruned, 1 if kept, 2 if cloned or split.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/finite.glsl"
#include "lib/density.glsl"

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Growth { vec2 growth[]; };
layout(binding = 2, std430) readonly buffer Means { float means[]; };
layout(binding = 3, std430) readonly buffer LogScales { float log_scales[]; };
layout(binding = 4, std430) readonly buffer Rotations { vec4 rotations[]; };
layout(binding = 5, std430) readonly buffer Logits { float logits[]; };
layout(binding = 6, std430) writeonly buffer Copies { uint copies[]; };
layout(binding = 7, std430) writeonly buffer Splits { uint splits[]; }; // 1 if the two copies replace their parent
layout(push_constant) uniform Push {
    vec4 cameras;        // mean of the cameras' centres; w: the scene's extent
    float threshold;     // mean gradient norm in NDC units at which a Gaussian grows
    float split_scale;   // log of the largest axis over the reach, above which a growing Gaussian splits instead of being cloned
    float largest_scale; // the same, above which a Gaussian is pruned
    float least_logit;   // opacity logit below which a Gaussian is pruned
};

void main() {
    uint i = global_index();
    if (i >= count[0]) return;
    vec3 scale = ROW3(log_scales, i);
    vec3 mean = ROW3(means, i);
    // Sizes are relative to the scene's extent near the cameras and to the distance beyond it: a far sky needs large Gaussians.
    float reach = max(cameras.w, length(mean - cameras.xyz));
    float largest = max(scale.x, max(scale.y, scale.z)) - log(reach);
    bool sound = finite(mean) && finite(scale) && finite(rotations[i]) && finite(logits[i]);
    vec2 g = growth[i];
    bool grows = finite(g.x) && g.y > 0 && g.x >= threshold * g.y; // an infinite sum would pass every threshold
    bool split = grows && largest > split_scale;
    // A Gaussian that splits is judged by its halves. Faint ones are pruned, growing or not.
    float left = split ? largest - LN_SHRINK : largest;
    bool pruned = !sound || logits[i] < least_logit || left > largest_scale;
    copies[i] = pruned ? 0 : grows ? 2 : 1;
    splits[i] = split ? 1 : 0;
}
