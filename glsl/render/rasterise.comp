// Blends each tile's Gaussians front to back. An invocation holds PIXELS pixels of the tile in registers, so that a
// splat is read once for all of them: one pixel if the workgroup is as large as the tile, eight or more if one subgroup
// walks it. If several subgroups share the tile, each owns a block of its pixels and blends only the splats that come
// near it: a splat that misses the block would have an alpha of 0 at each of its pixels.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/blending.glsl"
#include "lib/view.glsl"
#include "lib/splat.glsl"
#include "lib/walked_tile.glsl"
#include "lib/ellipse.glsl"

layout(constant_id = 2) const uint TILE = 16;
// Splats staged in shared memory at a time; 0 if one subgroup walks the tile, each lane reading one splat.
layout(constant_id = 3) const uint BATCH = 256;
layout(constant_id = 4) const float STOP = TRANSMITTANCE_STOP;
layout(constant_id = 5) const uint PIXELS = 1; // TILE x TILE / WORKGROUP
// For tests: the fourth value of a pixel is the number of batches that its tile has loaded.
layout(constant_id = 6) const bool COUNT_BATCHES = false;
// For pictures of the cost per pixel: red is the number of splats that the pixel blends.
layout(constant_id = 7) const bool COUNT_BLENDED = false;
// For depths, which are the colours then: green is the red of the splat with which half of the light is stopped, or 0.
layout(constant_id = 8) const bool MEDIANS = false;

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Starts { uint starts[]; };
layout(binding = 2, std430) readonly buffer Slots { uint slots[]; };
layout(binding = 3, std430) readonly buffer Owners { uint owners[]; };
layout(binding = 4, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 5, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 6, std430) readonly buffer Colour { vec2 colour[]; };
layout(binding = 7, std430) writeonly buffer Image { vec4 image[]; }; // red, green, blue, alpha

#include "lib/blocks_of_tile.glsl"

// The shape of a splat that no pixel draws.
const vec4 NOTHING = vec4(0, 0, -1, 0);
const uint SHARED = BATCH == 0 ? 1 : BATCH;
shared vec4 batch_geometry[SHARED];
shared vec4 batch_shape[SHARED];
shared vec2 batch_colour[SHARED];
shared bool finished[WORKGROUP / SUBGROUP]; // by subgroup: true if all its pixels are done

vec2 centre[PIXELS]; // from the view's origin
vec3 blended[PIXELS];
float transmittance[PIXELS]; // negative once the pixel is done
uint counts[PIXELS]; // splats blended
float medians[PIXELS];

void blend(vec4 g, vec4 s, vec2 c) {
    vec3 k = vec3(g.zw, s.x);
    vec3 rgb = vec3(s.w, c);
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        float power = splat_distance(centre[p] - g.xy, k);
        float t = transmittance[p];
        float alpha = power <= s.z ? min(ALPHA_MAX, exp2(s.y - power)) : 0;
        float w = t * alpha;
        float next = t - w; // not t (1 - alpha): equal layers have the same rounding error in 1 - alpha, and the errors add up
        bool live = t > 0;
        bool stop = next < STOP;
        blended[p] += (live && !stop ? w : 0) * rgb;
        if (COUNT_BLENDED) counts[p] += uint(live && !stop && alpha > 0);
        if (MEDIANS && live && !stop && t > 0.5 && next <= 0.5) medians[p] = rgb.r;
        transmittance[p] = live ? (stop ? -t : next) : t;
    }
}

bool done() {
    float most = transmittance[0];
    [[unroll]] for (uint p = 1; p < PIXELS; p++) most = max(most, transmittance[p]);
    return most <= 0;
}

// True if all pixels of the tile are done; contains a barrier for the workgroup.
bool tile_done() {
    bool own = subgroupAll(done());
    if (subgroupElect()) finished[gl_SubgroupID] = own;
    barrier();
    bool all = true;
    for (uint s = 0; s < WORKGROUP / SUBGROUP; s++) all = all && finished[s];
    return all;
}

// A pixel of this invocation, relative to the tile: in the subgroup's block, or in rows if one subgroup walks the tile.
uvec2 pixel_in_tile(uint p) {
    uint n = p * WORKGROUP + gl_LocalInvocationID.x;
    return BATCH == 0 ? uvec2(n % TILE, n / TILE) : block_corner(gl_SubgroupID) + block_pixel(gl_SubgroupInvocationID, p);
}

// Blends those splats of a staged batch that come near the subgroup's block, [low, high], two at a time: the second
// one's alpha at a pixel does not wait for the first.
void walk_batch(uint length, vec2 low, vec2 high) {
    for (uint first = 0; first < length && !subgroupAll(done()); first += SUBGROUP) {
        uint own = first + gl_SubgroupInvocationID;
        vec4 g = batch_geometry[own], s = batch_shape[own];
        bool touches = ellipse_touches(g.xy, vec3(g.zw, s.x), s.z, low, high);
        uvec4 near = subgroupBallot(touches && own < length);
        [[unroll]] for (uint w = 0; w < (SUBGROUP + 31) / 32; w++) {
            for (uint left = near[w]; left != 0; left &= left - 1) {
                uint one = first + 32 * w + findLSB(left);
                left &= left - 1;
                uint other = left != 0 ? first + 32 * w + findLSB(left) : one;
                vec4 one_geometry = batch_geometry[one], one_shape = batch_shape[one];
                vec4 other_geometry = batch_geometry[other], other_shape = batch_shape[other];
                vec2 one_colour = batch_colour[one], other_colour = batch_colour[other];
                blend(one_geometry, one_shape, one_colour);
                blend(other_geometry, left != 0 ? other_shape : NOTHING, other_colour);
            }
        }
    }
}

void main() {
    uvec2 tiles = view[0].tiles;
    uint tile = walked_tile(group_index(), tiles);
    if (tile >= tiles.x * tiles.y) return;
    uint lane = gl_LocalInvocationID.x;
    uvec2 corner = uvec2(tile % tiles.x, tile / tiles.x) * TILE;
    uvec2 size = view[0].size;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        uvec2 at = corner + pixel_in_tile(p);
        centre[p] = vec2(at) + 0.5 - origin(view[0]);
        blended[p] = vec3(0);
        counts[p] = 0;
        medians[p] = 0;
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
        vec2 low = vec2(corner + block_corner(gl_SubgroupID)) + 0.5 - origin(view[0]);
        vec2 high = low + vec2(BLOCK_WIDTH - 1, BLOCK_HEIGHT - 1);
        for (uint first = start; first < end && !tile_done(); first += BATCH) {
            batches++;
            // All loads are issued before the first store waits for one: BATCH = WORKGROUP.
            uint i = owners[slots[min(first + lane, end - 1)]];
            vec4 own_geometry = geometry[i], own_shape = shape[i];
            vec2 own_colour = colour[i];
            batch_geometry[lane] = own_geometry;
            batch_shape[lane] = own_shape;
            batch_colour[lane] = own_colour;
            barrier();
            walk_batch(min(BATCH, end - first), low, high);
        }
    }
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        uvec2 at = corner + pixel_in_tile(p);
        float t = abs(transmittance[p]);
        vec4 rgba = vec4(blended[p] + t * view[0].background.rgb, 1 - t);
        if (COUNT_BLENDED) rgba.r = float(counts[p]);
        if (MEDIANS) rgba.g = medians[p];
        if (COUNT_BATCHES) rgba.a = float(batches);
        if (all(lessThan(at, size))) image[at.y * size.x + at.x] = rgba;
    }
}
