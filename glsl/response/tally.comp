// Adds up the slots of response/score.comp by Gaussian, in slot order, on top of the scores of earlier views.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 2, std430) readonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 3, std430) readonly buffer FirstSlots { uint first_slots[]; };
layout(binding = 4, std430) readonly buffer Tallies { vec4 tallies[]; };
layout(binding = 5, std430) buffer Scores { vec4 scores[]; }; // sum of T alpha, its largest, hits, sum of opacity x T
layout(push_constant) uniform Push { uint pair_limit; };

void main() {
    uint i = global_index();
    if (pairs[1] > pair_limit || i >= count[0]) return;
    uint slots = tile_counts[i];
    if (slots == 0) return;
    vec4 sum = vec4(0);
    uint first = first_slots[i];
    for (uint slot = first; slot < first + slots; slot++) {
        vec4 s = tallies[slot];
        sum = vec4(sum.x + s.x, max(sum.y, s.y), sum.zw + s.zw);
    }
    vec4 old = scores[i];
    scores[i] = vec4(old.x + sum.x, max(old.y, sum.y), old.zw + sum.zw);
}
