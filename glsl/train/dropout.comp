// Leaves Gaussians out of a picture by chance: their cut (lib/splat.glsl) becomes negative, as masked ones' does. The others'
// opacities rise by as much as the picture loses in the mean.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/random.glsl"

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 3, std430) buffer Shape { vec4 shape[]; };
layout(push_constant) uniform Push {
    uint pair_limit;
    uint seed;
    uint iteration;
    float share; // of the Gaussians that are left out
};

void main() {
    uint i = global_index();
    if (pairs[1] > pair_limit || i >= count[0] || tile_counts[i] == 0) return;
    uint h = hash(iteration ^ hash(seed ^ hash(i ^ hash(5u))));
    if ((float(h >> 8) + 0.5) / 16777216.0 < share) shape[i].z = -shape[i].z;
    else shape[i].y -= log2(1 - share);
}
