// Scores that other pruning methods rank by, tile by tile: for each slot the sum and the largest of T alpha over the tile's
// pixels, the number of pixels that blend it, and the sum of opacity x T. One subgroup walks a tile front to back.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/blending.glsl"
#include "lib/view.glsl"

layout(constant_id = 2) const uint TILE = 16;
layout(constant_id = 3) const uint PIXELS = 8; // TILE x TILE / SUBGROUP
layout(constant_id = 4) const float STOP = TRANSMITTANCE_STOP;

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Starts { uint starts[]; };
layout(binding = 2, std430) readonly buffer Slots { uint slots[]; };
layout(binding = 3, std430) readonly buffer Owners { uint owners[]; };
layout(binding = 4, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 5, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 6, std430) writeonly buffer Tallies { float tallies[]; }; // four for each slot

vec2 centre[PIXELS]; // from the view's origin
float transmittance[PIXELS]; // 0 once the pixel is done

void main() {
    uint tile = group_index();
    uvec2 tiles = view[0].tiles;
    if (tile >= tiles.x * tiles.y) return;
    uint lane = gl_SubgroupInvocationID;
    uvec2 corner = uvec2(tile % tiles.x, tile / tiles.x) * TILE;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        uint n = p * SUBGROUP + lane;
        uvec2 at = corner + uvec2(n % TILE, n / TILE);
        centre[p] = vec2(at) + 0.5 - origin(view[0]);
        transmittance[p] = all(lessThan(at, view[0].size)) ? 1 : 0;
    }
    uint start = starts[tile], end = starts[tile + 1];
    for (uint n = start; n < end; n++) {
        uint slot = slots[n];
        uint i = owners[slot];
        vec4 g = geometry[i], s = shape[i];
        float opacity = exp2(s.y);
        vec3 sums = vec3(0);
        float most = 0;
        [[unroll]] for (uint p = 0; p < PIXELS; p++) {
            vec2 d = centre[p] - g.xy;
            float u = g.z * d.x + g.w * d.y;
            float v = s.x * d.y;
            float power = u * u + v * v;
            float t = transmittance[p];
            float alpha = min(ALPHA_MAX, exp2(s.y - power));
            float part = t * alpha;
            float next = t - part;
            bool drawn = power <= s.z && t > 0;
            bool live = drawn && next >= STOP;
            float w = live ? part : 0;
            sums += live ? vec3(w, 1, opacity * t) : vec3(0);
            most = max(most, w);
            transmittance[p] = live ? next : drawn ? 0 : t;
        }
        sums = subgroupAdd(sums);
        most = subgroupMax(most);
        float own = lane == 0 ? sums.x : lane == 1 ? most : lane == 2 ? sums.y : sums.z;
        if (lane < 4) tallies[4 * slot + lane] = own;
    }
}
