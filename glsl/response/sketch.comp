// Adds the signed sums that response/score.comp left in the slots to the sketch of each Gaussian: the rows of one tile of one
// view all go to one bucket, drawn by hashing, so that Gaussians of one tile meet there. In slot order, on top of earlier views.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/random.glsl"

layout(constant_id = 2) const uint BUCKETS = 32;

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 2, std430) readonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 3, std430) readonly buffer FirstSlots { uint first_slots[]; };
layout(binding = 4, std430) readonly buffer FirstSigns { vec4 first_signs[]; };
layout(binding = 5, std430) readonly buffer SecondSigns { vec4 second_signs[]; };
layout(binding = 6, std430) readonly buffer Tiles { vec4 tiles[]; };
layout(binding = 7, std430) buffer Sketches { vec4 sketches[]; }; // n x BUCKETS x 2
layout(push_constant) uniform Push {
    uint pair_limit;
    uint number; // of the view
};

void main() {
    uint i = global_index();
    if (pairs[1] > pair_limit || i >= count[0]) return;
    uint slots = tile_counts[i];
    uint first = first_slots[i];
    for (uint slot = first; slot < first + slots; slot++) {
        // Another hash than that of the signs.
        uint bucket = hash(hash(number + 0x9e3779b9u) ^ uint(tiles[slot].x)) % BUCKETS;
        uint at = 2 * (BUCKETS * i + bucket);
        sketches[at] += first_signs[slot];
        sketches[at + 1] += second_signs[slot];
    }
}
