// Blends each tile's Gaussians front to back. An invocation holds PIXELS pixels of the tile in registers, so that a splat is
// read once for all of them: one pixel where the workgroup is as large as the tile, eight or more where one subgroup walks it.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/blending.glsl"
#include "lib/view.glsl"
#include "lib/splat.glsl"
#include "lib/walked_tile.glsl"

layout(constant_id = 2) const uint TILE = 16;
// Splats staged in shared memory at a time; 0 where one subgroup walks the tile, each lane reading one splat.
layout(constant_id = 3) const uint BATCH = 256;
layout(constant_id = 4) const float STOP = TRANSMITTANCE_STOP;
layout(constant_id = 5) const uint PIXELS = 1; // TILE x TILE / WORKGROUP
// For tests: the fourth value of a pixel is the number of batches that its tile has loaded.
layout(constant_id = 6) const bool COUNT_BATCHES = false;
// For pictures of what pixels cost: red is the number of splats that the pixel blends.
layout(constant_id = 7) const bool COUNT_BLENDED = false;

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Starts { uint starts[]; };
layout(binding = 2, std430) readonly buffer Slots { uint slots[]; };
layout(binding = 3, std430) readonly buffer Owners { uint owners[]; };
layout(binding = 4, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 5, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 6, std430) readonly buffer Colour { vec2 colour[]; };
layout(binding = 7, std430) writeonly buffer Image { vec4 image[]; }; // red, green, blue, alpha

// Splats blended between two looks at whether the pixel is done: what each is at the pixel does not wait for those before it.
const uint AT_ONCE = 4;
// The shape of a splat that no pixel draws, which fills a batch up.
const vec4 NOTHING = vec4(0, 0, -1, 0);
const uint SHARED = BATCH == 0 ? 1 : BATCH;
shared vec4 batch_geometry[SHARED];
shared vec4 batch_shape[SHARED];
shared vec2 batch_colour[SHARED];
shared bool finished[WORKGROUP / SUBGROUP]; // by subgroup: whether all of its pixels are done

vec2 centre[PIXELS]; // from the view's origin
vec3 blended[PIXELS];
float transmittance[PIXELS]; // negative once the pixel is done
uint counts[PIXELS]; // splats blended

void blend(vec4 g, vec4 s, vec2 c) {
    vec3 k = vec3(g.zw, s.x);
    vec3 rgb = vec3(s.w, c);
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        float power = splat_distance(centre[p] - g.xy, k);
        float t = transmittance[p];
        float alpha = power <= s.z ? min(ALPHA_MAX, exp2(s.y - power)) : 0;
        float w = t * alpha;
        float next = t - w; // not t (1 - alpha): equal layers round 1 - alpha alike, and the errors add up
        bool live = t > 0;
        bool stop = next < STOP;
        blended[p] += (live && !stop ? w : 0) * rgb;
        if (COUNT_BLENDED) counts[p] += uint(live && !stop && alpha > 0);
        transmittance[p] = live ? (stop ? -t : next) : t;
    }
}

bool done() {
    bool all = true;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) all = all && transmittance[p] <= 0;
    return all;
}

// Whether all pixels of the tile are done; a barrier for the workgroup.
bool tile_done() {
    bool own = subgroupAll(done());
    if (subgroupElect()) finished[gl_SubgroupID] = own;
    barrier();
    bool all = true;
    for (uint s = 0; s < WORKGROUP / SUBGROUP; s++) all = all && finished[s];
    return all;
}

void main() {
    uvec2 tiles = view[0].tiles;
    uint tile = walked_tile(group_index(), tiles);
    if (tile >= tiles.x * tiles.y) return;
    uint lane = gl_LocalInvocationID.x;
    uvec2 corner = uvec2(tile % tiles.x, tile / tiles.x) * TILE;
    uvec2 size = view[0].size;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        uint n = p * WORKGROUP + lane;
        uvec2 at = corner + uvec2(n % TILE, n / TILE);
        centre[p] = vec2(at) + 0.5 - origin(view[0]);
        blended[p] = vec3(0);
        counts[p] = 0;
        transmittance[p] = all(lessThan(at, size)) ? 1 : -1;
    }
    uint start = starts[tile], end = starts[tile + 1];
    uint batches = 0;

    if (BATCH == 0) {
        // The workgroup is one subgroup: each lane reads one splat, and all lanes blend each in turn.
        for (uint first = start; first < end && !subgroupAll(done()); first += SUBGROUP) {
            batches++;
            uint length = min(SUBGROUP, end - first);
            uint i = owners[slots[min(first + lane, end - 1)]];
            vec4 my_geometry = geometry[i], my_shape = shape[i];
            vec2 my_colour = colour[i];
            for (uint n = 0; n < length; n++) {
                blend(subgroupShuffle(my_geometry, n), subgroupShuffle(my_shape, n), subgroupShuffle(my_colour, n));
            }
        }
    } else {
        for (uint first = start; first < end && !tile_done(); first += BATCH) {
            batches++;
            uint length = min(BATCH, end - first);
            for (uint n = lane; n < BATCH; n += WORKGROUP) {
                uint i = owners[slots[min(first + n, end - 1)]];
                batch_geometry[n] = geometry[i];
                batch_shape[n] = n < length ? shape[i] : NOTHING;
                batch_colour[n] = colour[i];
            }
            barrier();
            for (uint n = 0; n < length && !done(); n += AT_ONCE) {
                [[unroll]] for (uint k = n; k < n + AT_ONCE; k++) blend(batch_geometry[k], batch_shape[k], batch_colour[k]);
            }
        }
    }
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        uint n = p * WORKGROUP + lane;
        uvec2 at = corner + uvec2(n % TILE, n / TILE);
        float t = abs(transmittance[p]);
        vec4 rgba = vec4(blended[p] + t * view[0].background.rgb, 1 - t);
        if (COUNT_BLENDED) rgba.r = float(counts[p]);
        if (COUNT_BATCHES) rgba.a = float(batches);
        if (all(lessThan(at, size))) image[at.y * size.x + at.x] = rgba;
    }
}
