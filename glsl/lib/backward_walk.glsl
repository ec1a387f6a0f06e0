// Gradients of a tile's pixels by its splats. One subgroup walks the tile's list front to back once more, its pixels in
// registers; each splat's sums over those pixels are reduced across the subgroup, and one lane hands them in.
//
// With q = dL/dC . c and R the part of dL/dC . C that lies behind, dL/dalpha = T q - R / (1 - alpha): each pixel carries one
// scalar instead of three. With h = alpha dL/dalpha the sums are the moments of h over (u, v) of lib/splat.glsl: 1, u, v
// (gradient by the position), uu, uv, vv (by the covariance); the projection's backward pass goes on from them.
//
// The including shader defines where the sums go, by hand_in(slot, Gaussian, position, covariance, colour) and
// hand_in_none(slot), and it defines RESIDUAL: whether the image gradient's fourth component is a residual, by which
// contributions are weighed, instead of dL/dalpha.
#include "lib/blending.glsl"
#include "lib/lane_sum.glsl"
#include "lib/view.glsl"
#include "lib/splat.glsl"

layout(constant_id = 2) const uint TILE = 16;
layout(constant_id = 3) const uint PIXELS = 8; // TILE x TILE / SUBGROUP
layout(constant_id = 4) const float STOP = TRANSMITTANCE_STOP;

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Starts { uint starts[]; };
layout(binding = 2, std430) readonly buffer Slots { uint slots[]; };
layout(binding = 3, std430) readonly buffer Owners { uint owners[]; };
layout(binding = 4, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 5, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 6, std430) readonly buffer Colour { vec2 colour[]; };
layout(binding = 7, std430) readonly buffer Image { vec4 image[]; };
layout(binding = 8, std430) readonly buffer ImageGradient { vec4 image_gradient[]; }; // by red, green, blue and alpha

vec2 centre[PIXELS]; // from the view's origin
float transmittance[PIXELS]; // 0 once the pixel is done
float behind[PIXELS];
vec4 gradient[PIXELS];

float worth(vec4 g, vec4 c) { return RESIDUAL ? dot(g.rgb, c.rgb) : dot(g, c); }

bool done() {
    bool all = true;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) all = all && transmittance[p] <= 0;
    return all;
}

void main() {
    uint tile = group_index();
    uvec2 tiles = view[0].tiles;
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
        behind[p] = worth(gradient[p], image[pixel]);
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
        vec4 my_position_sum = vec4(0), my_covariance_sum = vec4(0), my_colour_sum = vec4(0);
        for (uint n = 0; n < length; n++) {
            vec4 g = subgroupShuffle(my_geometry, n), s = subgroupShuffle(my_shape, n);
            vec4 rgb1 = vec4(s.w, subgroupShuffle(my_colour, n), 1);
            vec3 k = vec3(g.zw, s.x);
            vec4 position_sum = vec4(0), covariance_sum = vec4(0), colour_sum = vec4(0);
            [[unroll]] for (uint p = 0; p < PIXELS; p++) {
                vec2 d = centre[p] - g.xy;
                float u = k.x * d.x + k.y * d.y;
                float v = k.z * d.y;
                float power = u * u + v * v;
                float t = transmittance[p];
                float free = exp2(s.y - power);
                float alpha = min(ALPHA_MAX, free);
                float part = t * alpha;
                float next = t - part; // as in the forward pass
                bool drawn = power <= s.z && t > 0;
                bool live = drawn && next >= STOP;
                float w = live ? part : 0;
                float q = worth(gradient[p], rgb1);
                float r = behind[p] - w * q;
                behind[p] = r;
                float by_alpha = t * q - r / max(1 - alpha, ONE_MINUS_ALPHA_FLOOR);
                float h = live && free < ALPHA_MAX ? alpha * by_alpha : 0;
                float hu = h * u, hv = h * v;
                position_sum += vec4(h, hu, hv, RESIDUAL ? w : 0);
                covariance_sum += vec4(hu * u, hu * v, hv * v, RESIDUAL && live ? alpha : 0);
                colour_sum += w * vec4(gradient[p].rgb, RESIDUAL ? gradient[p].a : 0);
                transmittance[p] = live ? next : drawn ? 0 : t;
            }
            position_sum = lane_sum(position_sum);
            covariance_sum = lane_sum(covariance_sum);
            colour_sum = lane_sum(colour_sum);
            bool own = lane == n;
            my_position_sum = own ? position_sum : my_position_sum;
            my_covariance_sum = own ? covariance_sum : my_covariance_sum;
            my_colour_sum = own ? colour_sum : my_colour_sum;
        }
        if (lane < length) hand_in(slot, i, my_position_sum, my_covariance_sum, my_colour_sum);
    }
    // Splats behind the point where the last pixel ended are not drawn.
    for (uint n = first + lane; n < end; n += SUBGROUP) hand_in_none(slots[n]);
}
