// Adds up the slots of response/score.comp by Gaussian, in slot order, on top of the scores of earlier views, one by
// one, so that a picture may be scored in parts, from its first tiles to its last, with the same result.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 2, std430) readonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 3, std430) readonly buffer FirstSlots { uint first_slots[]; };
layout(binding = 4, std430) readonly buffer Weights { vec4 weights[]; };
layout(binding = 5, std430) readonly buffer Changes { vec4 changes[]; };
layout(binding = 6, std430) readonly buffer Behinds { vec4 behinds[]; };
layout(binding = 7, std430) buffer Scores { vec4 scores[]; }; // three for each Gaussian: weights, changes, behinds
layout(push_constant) uniform Push { uint pair_limit; };

void main() {
    uint i = global_index();
    if (pairs[1] > pair_limit || i >= count[0]) return;
    uint slots = tile_counts[i];
    if (slots == 0) return;
    vec4 weight = scores[3 * i], change = scores[3 * i + 1], behind = scores[3 * i + 2];
    uint first = first_slots[i];
    for (uint slot = first; slot < first + slots; slot++) {
        vec4 w = weights[slot];
        weight = vec4(weight.x + w.x, max(weight.y, w.y), weight.zw + w.zw);
        change += changes[slot];
        behind += behinds[slot];
    }
    scores[3 * i] = weight;
    scores[3 * i + 1] = change;
    scores[3 * i + 2] = behind;
}
