// Writes one (tile, slot) pair for each tile that a visible Gaussian touches, Gaussians in depth order. An invocation
// handles a Gaussian of its own; a whole subgroup handles those with many tiles, one row of tiles per invocation. With
// DEPTH_ORDER it also writes the depth by which each tile orders its Gaussians.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/view.glsl"
#include "lib/tiles.glsl"
#include "lib/projection.glsl"

layout(constant_id = 4) const bool DEPTH_ORDER = false;
layout(constant_id = 5) const uint MANY = 0; // tiles from which a Gaussian is shared; 0 for never

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Count { uint count[]; }; // visible Gaussians
layout(binding = 2, std430) readonly buffer Pairs { uint pairs[]; }; // 0: their number, 0 when they do not fit
layout(binding = 3, std430) readonly buffer Order { uint order[]; };
layout(binding = 4, std430) readonly buffer Offsets { uint offsets[]; }; // by depth
layout(binding = 5, std430) buffer TileCounts { uint tile_counts[]; }; // by Gaussian
layout(binding = 6, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 7, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 8, std430) writeonly buffer Keys { uint keys[]; }; // tiles
layout(binding = 9, std430) writeonly buffer Slots { uint slots[]; };
layout(binding = 10, std430) writeonly buffer Owners { uint owners[]; }; // Gaussian of each slot
layout(binding = 11, std430) writeonly buffer FirstSlots { uint first_slots[]; }; // by Gaussian
layout(binding = 12, std430) writeonly buffer Depths { uint depths[]; }; // of slots
layout(binding = 13, std430) readonly buffer Means { float means[]; };
layout(binding = 14, std430) readonly buffer LogScales { float log_scales[]; };
layout(binding = 15, std430) readonly buffer Rotations { vec4 rotations[]; };

const float DRAWN_DEVIATIONS = 3.3291; // sqrt(2 ln 255): where an opaque Gaussian's alpha falls to 1/255

// A Gaussian in the form from which its densest point along a ray is computed.
struct Densest {
    mat3 axes;     // in camera space
    vec3 narrow;   // the least standard deviation divided by each axis's own
    vec3 position; // of the mean, along the axes, times narrow
    float depth;   // of the mean
    float reach;   // largest distance along z of a drawn part from the mean
};

Densest densest_of(View v, uint i) {
    vec3 mean = ROW3(means, i);
    vec3 log_scale = ROW3(log_scales, i);
    Projection p = project(v, mean, log_scale, rotations[i]);
    Densest d;
    d.axes = world_to_camera(v) * p.rotation;
    d.narrow = exp(min(log_scale.x, min(log_scale.y, log_scale.z)) - log_scale);
    d.position = d.narrow * (p.position * d.axes);
    d.depth = p.depth;
    d.reach = DRAWN_DEVIATIONS * length(vec3(d.axes[0].z, d.axes[1].z, d.axes[2].z) * p.scale);
    return d;
}

// The bits of the depth at which the Gaussian is densest along the ray (x, y, 1): positive floats have the order of their bits.
uint densest_at(View v, Densest d, vec2 ray) {
    vec3 along = d.narrow * (vec3(ray, 1) * d.axes);
    float depth = dot(along, d.position) / dot(along, along);
    // For a disc seen edge-on it is 0 / 0.
    if (nan(depth)) depth = d.depth;
    depth = clamp(depth, d.depth - d.reach, d.depth + d.reach);
    // Those before the near plane keep their order, between 0 and it.
    float near = v.centre.w;
    return floatBitsToUint(depth < near ? near * (near / (2 * near - depth)) : depth);
}

// A Gaussian whose pairs are being written.
struct Emitted {
    uint gaussian;
    Footprint footprint;
    uvec2 rows; // of tiles
    Densest densest;
    uint end; // of its slots
};

Emitted emitted(uint i, uint end) {
    Emitted e;
    vec4 g = geometry[i], s = shape[i];
    e.gaussian = i;
    e.footprint = footprint_of(g.xy, origin(view[0]), vec3(g.zw, s.x), s.z);
    e.rows = tile_rows(e.footprint, view[0].tiles);
    if (DEPTH_ORDER) e.densest = densest_of(view[0], i);
    e.end = end;
    return e;
}

void emit(Emitted e, uint slot, uint tile, uint depth) {
    keys[slot] = tile;
    slots[slot] = slot;
    owners[slot] = e.gaussian;
    if (DEPTH_ORDER) depths[slot] = depth;
}

// Writes the pairs of a row of tiles, as far as there are slots.
void emit_row(Emitted e, uint row, uvec2 columns, uint slot) {
    uvec2 tiles = view[0].tiles;
    for (uint column = columns.x; column < columns.y && slot < e.end; column++, slot++) {
        vec2 middle = (vec2(column, row) + 0.5) * float(TILE) - origin(view[0]);
        uint depth = DEPTH_ORDER ? densest_at(view[0], e.densest, (middle - view[0].principal) / view[0].focal) : 0;
        emit(e, slot, row * tiles.x + column, depth);
    }
}

// Compilers may round differently in this shader and in the counting one: surplus slots, which begin at `surplus`, go to a tile
// beyond the last. No tile adds anything up in them, so they are taken off the Gaussian's count.
void emit_surplus(Emitted e, uint first, uint surplus, uint own, uint apart) {
    uvec2 tiles = view[0].tiles;
    if (own == 0 && surplus < e.end) tile_counts[e.gaussian] = surplus - first;
    uint slot = surplus + own;
    for (; slot < e.end; slot += apart) emit(e, slot, tiles.x * tiles.y, 0);
}

void alone(Emitted e, uint first) {
    uint slot = first;
    for (uint row = e.rows.x; row < e.rows.y; row++) {
        uvec2 columns = tile_columns(e.footprint, row, view[0].tiles);
        emit_row(e, row, columns, slot);
        slot += columns.y - columns.x;
    }
    emit_surplus(e, first, slot, 0, 1);
}

void together(Emitted e, uint first) {
    uint slot = first;
    for (uint start = e.rows.x; start < e.rows.y; start += SUBGROUP) {
        uint row = start + gl_SubgroupInvocationID;
        uvec2 columns = row < e.rows.y ? tile_columns(e.footprint, row, view[0].tiles) : uvec2(0);
        uint own = columns.y - columns.x;
        uint inclusive = subgroupInclusiveAdd(own);
        uint all = subgroupBroadcast(inclusive, SUBGROUP - 1); // before the lanes part
        emit_row(e, row, columns, slot + inclusive - own);
        slot += all;
    }
    emit_surplus(e, first, slot, gl_SubgroupInvocationID, SUBGROUP);
}

void main() {
    uint j = global_index();
    bool there = j < count[0] && pairs[0] != 0;
    uint i = 0, slot = 0, end = 0;
    if (there) {
        i = order[j];
        slot = offsets[j];
        first_slots[i] = slot;
        end = min(slot + tile_counts[i], pairs[0]); // no store beyond the buffers, whatever was counted
    }
    bool many = MANY > 0 && end > slot && end - slot >= MANY;
    if (there && !many) alone(emitted(i, end), slot);
    if (MANY == 0) return;
    uvec4 left = subgroupBallot(many);
    [[unroll]] for (uint w = 0; w < (SUBGROUP + 31) / 32; w++) {
        for (uint lanes = left[w]; lanes != 0; lanes &= lanes - 1) {
            uint lane = 32 * w + findLSB(lanes);
            together(emitted(subgroupShuffle(i, lane), subgroupShuffle(end, lane)), subgroupShuffle(slot, lane));
        }
    }
}
