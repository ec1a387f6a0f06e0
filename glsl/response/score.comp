// What a picture owes to each splat, tile by tile: for each slot sums over the tile's pixels, which tally.comp adds up by
// Gaussian. One subgroup walks a tile front to back.
//
// Removing a splat exactly changes a pixel by -phi, phi = T alpha (c - b), where b is the colour behind it: what lies behind is
// then seen through T instead of T (1 - alpha). With R the part of the picture that lies behind, T alpha b = R alpha / (1 - alpha).
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/blending.glsl"
#include "lib/lane_sum.glsl"
#include "lib/view.glsl"
#include "lib/walked_tile.glsl"

layout(constant_id = 2) const uint TILE = 16;
layout(constant_id = 3) const uint PIXELS = 8; // TILE x TILE / SUBGROUP
layout(constant_id = 4) const float STOP = TRANSMITTANCE_STOP;
layout(constant_id = 5) const bool RESIDUAL = false; // true if the residual's colours count

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Starts { uint starts[]; };
layout(binding = 2, std430) readonly buffer Slots { uint slots[]; };
layout(binding = 3, std430) readonly buffer Owners { uint owners[]; };
layout(binding = 4, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 5, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 6, std430) readonly buffer Colour { vec2 colour[]; };
layout(binding = 7, std430) readonly buffer Image { vec4 image[]; };
layout(binding = 8, std430) readonly buffer Residual { vec4 residual[]; };
// By slot, w = T alpha: the sum of w, the largest w, the pixels that blend the splat, the sum of opacity x T;
layout(binding = 9, std430) writeonly buffer Weights { vec4 weights[]; };
// the sums of w^2, of |phi|^2, of phi . residual, and 0; and the sum of w b, and 0.
layout(binding = 10, std430) writeonly buffer Changes { vec4 changes[]; };
layout(binding = 11, std430) writeonly buffer Behinds { vec4 behinds[]; };

vec2 centre[PIXELS]; // from the view's origin
float transmittance[PIXELS]; // 0 once the pixel is done
vec3 behind[PIXELS];
vec3 off[PIXELS];

bool done() {
    bool all = true;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) all = all && transmittance[p] <= 0;
    return all;
}

void main() {
    uvec2 tiles = view[0].tiles;
    uint tile = walked_tile(group_index(), tiles);
    if (tile >= tiles.x * tiles.y) return;
    uint lane = gl_SubgroupInvocationID;
    uvec2 corner = uvec2(tile % tiles.x, tile / tiles.x) * TILE;
    uvec2 size = view[0].size;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        uint n = p * SUBGROUP + lane;
        uvec2 at = corner + uvec2(n % TILE, n / TILE);
        bool inside = all(lessThan(at, size));
        uint pixel = inside ? at.y * size.x + at.x : 0;
        centre[p] = vec2(at) + 0.5 - origin(view[0]);
        transmittance[p] = inside ? 1 : 0;
        behind[p] = image[pixel].rgb;
        off[p] = RESIDUAL ? residual[pixel].rgb : vec3(0);
    }
    uint start = starts[tile], end = starts[tile + 1];
    // Splats come in groups of the subgroup's size: each lane reads one of them and, in the end, writes its sums.
    uint first = start;
    for (; first < end && !subgroupAll(done()); first += SUBGROUP) {
        uint length = min(SUBGROUP, end - first);
        uint slot = slots[min(first + lane, end - 1)];
        uint i = owners[slot];
        vec4 my_geometry = geometry[i], my_shape = shape[i];
        vec2 my_colour = colour[i];
        vec4 my_weights = vec4(0), my_changes = vec4(0), my_behind = vec4(0);
        for (uint n = 0; n < length; n++) {
            vec4 g = subgroupShuffle(my_geometry, n), s = subgroupShuffle(my_shape, n);
            vec3 rgb = vec3(s.w, subgroupShuffle(my_colour, n));
            float opacity = exp2(s.y);
            vec4 weight = vec4(0), change = vec4(0), through = vec4(0);
            float most = 0;
            [[unroll]] for (uint p = 0; p < PIXELS; p++) {
                vec2 d = centre[p] - g.xy;
                float u = g.z * d.x + g.w * d.y;
                float v = s.x * d.y;
                float power = u * u + v * v;
                float t = transmittance[p];
                float alpha = min(ALPHA_MAX, exp2(s.y - power));
                float part = t * alpha;
                float next = t - part; // as in the forward pass
                bool drawn = power <= s.z && t > 0;
                bool live = drawn && next >= STOP;
                float w = live ? part : 0;
                vec3 r = behind[p] - w * rgb;
                vec3 seen_behind = live ? r * (alpha / max(1 - alpha, ONE_MINUS_ALPHA_FLOOR)) : vec3(0);
                vec3 phi = w * rgb - seen_behind;
                weight += live ? vec4(w, 0, 1, opacity * t) : vec4(0);
                most = max(most, w);
                change += vec4(w * w, dot(phi, phi), RESIDUAL ? dot(phi, off[p]) : 0, 0);
                through += vec4(seen_behind, 0);
                behind[p] = r;
                transmittance[p] = live ? next : drawn ? 0 : t;
            }
            weight = lane_sum(weight);
            weight.y = subgroupMax(most);
            change = lane_sum(change);
            through = lane_sum(through);
            bool own = lane == n;
            my_weights = own ? weight : my_weights;
            my_changes = own ? change : my_changes;
            my_behind = own ? through : my_behind;
        }
        if (lane < length) {
            weights[slot] = my_weights;
            changes[slot] = my_changes;
            behinds[slot] = my_behind;
        }
    }
    // Splats behind the point where the last pixel ended are not drawn.
    for (uint n = first + lane; n < end; n += SUBGROUP) {
        uint slot = slots[n];
        weights[slot] = changes[slot] = behinds[slot] = vec4(0);
    }
}
