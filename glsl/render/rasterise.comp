// Blends each tile's Gaussians front to back, one pixel an invocation.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/constants.glsl"
#include "lib/view.glsl"
#include "lib/splat.glsl"

layout(constant_id = 2) const uint TILE = 16;
// Splats staged in shared memory at a time; 0 reads them in place, which is quicker where a barrier costs more than a load.
layout(constant_id = 3) const uint BATCH = 256;
layout(constant_id = 4) const float STOP = TRANSMITTANCE_STOP;

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Starts { uint starts[]; };
layout(binding = 2, std430) readonly buffer Slots { uint slots[]; };
layout(binding = 3, std430) readonly buffer Owners { uint owners[]; };
layout(binding = 4, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 5, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 6, std430) readonly buffer Colour { vec2 colour[]; };
layout(binding = 7, std430) writeonly buffer Image { vec4 image[]; }; // red, green, blue, alpha

const uint SHARED = BATCH == 0 ? 1 : BATCH;
shared vec4 batch_geometry[SHARED];
shared vec4 batch_shape[SHARED];
shared vec2 batch_colour[SHARED];

struct Pixel {
    vec2 centre;
    vec3 colour;
    float transmittance;
    bool done;
};

void blend(inout Pixel p, vec4 g, vec4 s, vec2 c) {
    float power = splat_distance(p.centre - g.xy, vec3(g.zw, s.x));
    if (power > s.z) return;
    float alpha = min(ALPHA_MAX, exp2(s.y - power));
    float next = p.transmittance * (1 - alpha);
    if (next < STOP) {
        p.done = true;
        return;
    }
    p.colour += p.transmittance * alpha * vec3(s.w, c);
    p.transmittance = next;
}

void main() {
    uint tile = group_index();
    uvec2 tiles = view[0].tiles;
    if (tile >= tiles.x * tiles.y) return;
    uint lane = gl_LocalInvocationID.x;
    uvec2 at = uvec2(tile % tiles.x, tile / tiles.x) * TILE + uvec2(lane % TILE, lane / TILE);
    bool inside = all(lessThan(at, view[0].size));
    Pixel p = Pixel(vec2(at) + 0.5, vec3(0), 1, !inside);
    uint start = starts[tile], end = starts[tile + 1];

    if (BATCH == 0) {
        for (uint n = start; n < end && !p.done; n++) {
            uint i = owners[slots[n]];
            blend(p, geometry[i], shape[i], colour[i]);
        }
    } else {
        for (uint first = start; first < end; first += BATCH) {
            uint length = min(BATCH, end - first);
            barrier();
            for (uint n = lane; n < length; n += WORKGROUP) {
                uint i = owners[slots[first + n]];
                batch_geometry[n] = geometry[i];
                batch_shape[n] = shape[i];
                batch_colour[n] = colour[i];
            }
            barrier();
            for (uint n = 0; n < length && !p.done; n++) blend(p, batch_geometry[n], batch_shape[n], batch_colour[n]);
        }
    }
    if (inside) image[at.y * view[0].size.x + at.x] = vec4(p.colour + p.transmittance * view[0].background.rgb, 1 - p.transmittance);
}
