// Hides the Gaussians that are masked in this iteration: their cut (lib/splat.glsl) becomes negative. No distance is
// negative, so the rasteriser and its backward pass draw nothing, while tiles keep their slots. Counts the others.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/learnt_mask.glsl"

layout(constant_id = 2) const bool SAMPLED = false; // true if masks are drawn at random; otherwise a threshold decides

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Scores { float scores[]; };
layout(binding = 3, std430) readonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 4, std430) buffer Shape { vec4 shape[]; };
layout(binding = 5, std430) buffer Shown { uint shown[]; }; // number of Gaussians that are not masked
layout(push_constant) uniform Push {
    uint pair_limit;
    uint seed;
    uint iteration;
};

void main() {
    uint i = global_index();
    if (pairs[1] > pair_limit || i >= count[0]) return;
    bool on = SAMPLED ? scores[i] + logistic(uvec3(seed, iteration, i)) > 0 : scores[i] > LEAST_SCORE;
    if (on) atomicAdd(shown[0], 1); // integers: the order does not matter
    else if (tile_counts[i] > 0) shape[i].z = -shape[i].z;
}
