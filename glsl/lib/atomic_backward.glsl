// The walk of rasterise_backward.comp, see there, whose sums are not written to slots but added to their Gaussian's own by
// add_a, add_b, add_c: one subgroup reduces a tile's pixels, then every lane adds one Gaussian's nine sums.
#include "lib/constants.glsl"
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
layout(binding = 8, std430) readonly buffer ImageGradient { vec4 image_gradient[]; }; // by red, green, blue, alpha

const float ONE_MINUS_ALPHA_FLOOR = 1e-6;

vec2 centre[PIXELS];
float transmittance[PIXELS]; // 0 once the pixel is done
float behind[PIXELS];
vec4 gradient[PIXELS];

vec3 lane_sum(vec3 x) {
    if (SUBGROUP != 8) return subgroupAdd(x);
    vec3 sum = subgroupBroadcast(x, 0);
    [[unroll]] for (uint l = 1; l < 8; l++) sum += subgroupBroadcast(x, l);
    return sum;
}

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
        centre[p] = vec2(at) + 0.5;
        transmittance[p] = inside ? 1 : 0;
        gradient[p] = inside ? image_gradient[pixel] : vec4(0);
        behind[p] = dot(gradient[p], image[pixel]);
    }
    uint start = starts[tile], end = starts[tile + 1];
    for (uint first = start; first < end && !subgroupAll(done()); first += SUBGROUP) {
        uint length = min(SUBGROUP, end - first);
        uint i = owners[slots[min(first + lane, end - 1)]];
        vec4 my_geometry = geometry[i], my_shape = shape[i];
        vec2 my_colour = colour[i];
        vec3 my_a = vec3(0), my_b = vec3(0), my_c = vec3(0);
        for (uint n = 0; n < length; n++) {
            vec4 g = subgroupBroadcast(my_geometry, n), s = subgroupBroadcast(my_shape, n);
            vec4 rgb1 = vec4(s.w, subgroupBroadcast(my_colour, n), 1);
            vec3 k = vec3(g.zw, s.x);
            vec3 a = vec3(0), b = vec3(0), c = vec3(0);
            [[unroll]] for (uint p = 0; p < PIXELS; p++) {
                vec2 d = centre[p] - g.xy;
                float u = k.x * d.x + k.y * d.y;
                float v = k.z * d.y;
                float power = u * u + v * v;
                float t = transmittance[p];
                float free = exp2(s.y - power);
                float alpha = min(ALPHA_MAX, free);
                float next = t * (1 - alpha);
                bool drawn = power <= s.z && t > 0;
                bool live = drawn && next >= STOP;
                float w = live ? t * alpha : 0;
                float q = dot(gradient[p], rgb1);
                float r = behind[p] - w * q;
                behind[p] = r;
                float by_alpha = t * q - r / max(1 - alpha, ONE_MINUS_ALPHA_FLOOR);
                float h = live && free < ALPHA_MAX ? alpha * by_alpha : 0;
                float hu = h * u, hv = h * v;
                a += vec3(h, hu, hv);
                b += vec3(hu * u, hu * v, hv * v);
                c += w * gradient[p].rgb;
                transmittance[p] = live ? next : drawn ? 0 : t;
            }
            a = lane_sum(a);
            b = lane_sum(b);
            c = lane_sum(c);
            bool own = lane == n;
            my_a = own ? a : my_a;
            my_b = own ? b : my_b;
            my_c = own ? c : my_c;
        }
        if (lane < length) {
            [[unroll]] for (uint k = 0; k < 3; k++) {
                add_a(4 * i + k, my_a[k]);
                add_b(4 * i + k, my_b[k]);
                add_c(4 * i + k, my_c[k]);
            }
        }
    }
}
