// Gradients by the masks, of the Gaussians that are masked, too: for each slot a sum over the tile's pixels. One subgroup walks a
// tile front to back.
//
// With the mask M a splat has the opacity M alpha in a pixel C = sum of M c T alpha, so that dL/dM = T alpha dL/dC . (c - b), where b is the
// colour behind it. Of R, the part of dL/dC . C that lies behind, T b is R where the splat is masked, else R / (1 - alpha).
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
layout(constant_id = 5) const bool COLOURS = false; // true if the image gradient's fourth component is none by alpha

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Starts { uint starts[]; };
layout(binding = 2, std430) readonly buffer Slots { uint slots[]; };
layout(binding = 3, std430) readonly buffer Owners { uint owners[]; };
layout(binding = 4, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 5, std430) readonly buffer Shape { vec4 shape[]; }; // after learnt_mask.comp
layout(binding = 6, std430) readonly buffer Colour { vec2 colour[]; };
layout(binding = 7, std430) readonly buffer Image { vec4 image[]; };
layout(binding = 8, std430) readonly buffer ImageGradient { vec4 image_gradient[]; }; // by red, green, blue and alpha
layout(binding = 9, std430) writeonly buffer Sums { float sums[]; }; // by slot

vec2 centre[PIXELS]; // from the view's origin
float transmittance[PIXELS]; // 0 once the pixel is done
float behind[PIXELS];
vec4 gradient[PIXELS];

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
        gradient[p] = inside ? image_gradient[pixel] : vec4(0);
        if (COLOURS) gradient[p].a = 0;
        behind[p] = dot(gradient[p], image[pixel]);
    }
    uint start = starts[tile], end = starts[tile + 1];
    // Splats come in groups of the subgroup's size: each lane reads one of them and, in the end, writes its sum.
    uint first = start;
    for (; first < end && !subgroupAll(done()); first += SUBGROUP) {
        uint length = min(SUBGROUP, end - first);
        uint slot = slots[min(first + lane, end - 1)];
        uint i = owners[slot];
        vec4 my_geometry = geometry[i], my_shape = shape[i];
        vec2 my_colour = colour[i];
        float mine = 0;
        for (uint n = 0; n < length; n++) {
            vec4 g = subgroupShuffle(my_geometry, n), s = subgroupShuffle(my_shape, n);
            vec4 rgb1 = vec4(s.w, subgroupShuffle(my_colour, n), 1);
            bool masked = s.z < 0;
            float sum = 0;
            [[unroll]] for (uint p = 0; p < PIXELS; p++) {
                vec2 d = centre[p] - g.xy;
                float u = g.z * d.x + g.w * d.y;
                float v = s.x * d.y;
                float power = u * u + v * v;
                float t = transmittance[p];
                float alpha = min(ALPHA_MAX, exp2(s.y - power));
                float part = t * alpha;
                float next = t - part; // as in the forward pass
                bool drawn = power <= abs(s.z) && t > 0;
                bool live = drawn && !masked && next >= STOP;
                float q = dot(gradient[p], rgb1);
                float r = behind[p] - (live ? part * q : 0);
                bool counts = drawn && (masked || live);
                sum += counts ? part * q - r * (masked ? alpha : alpha / max(1 - alpha, ONE_MINUS_ALPHA_FLOOR)) : 0;
                behind[p] = r;
                transmittance[p] = live ? next : drawn && !masked ? 0 : t;
            }
            sum = lane_sum(vec3(sum, 0, 0)).x;
            mine = lane == n ? sum : mine;
        }
        if (lane < length) sums[slot] = mine;
    }
    // Splats behind the point where the last pixel ended change nothing.
    for (uint n = first + lane; n < end; n += SUBGROUP) sums[slots[n]] = 0;
}
