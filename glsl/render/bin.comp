// Writes one (tile, slot) pair for each tile that a visible Gaussian touches, Gaussians in depth order.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/view.glsl"
#include "lib/tiles.glsl"

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Count { uint count[]; }; // visible Gaussians
layout(binding = 2, std430) readonly buffer Pairs { uint pairs[]; }; // 0 when they do not fit
layout(binding = 3, std430) readonly buffer Order { uint order[]; };
layout(binding = 4, std430) readonly buffer Offsets { uint offsets[]; }; // by depth
layout(binding = 5, std430) readonly buffer TileCounts { uint tile_counts[]; }; // by Gaussian
layout(binding = 6, std430) readonly buffer Geometry { vec4 geometry[]; };
layout(binding = 7, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 8, std430) writeonly buffer Keys { uint keys[]; };
layout(binding = 9, std430) writeonly buffer Slots { uint slots[]; };
layout(binding = 10, std430) writeonly buffer Owners { uint owners[]; }; // Gaussian of each slot
layout(binding = 11, std430) writeonly buffer FirstSlots { uint first_slots[]; }; // by Gaussian

void main() {
    uint j = global_index();
    if (j >= count[0] || pairs[0] == 0) return;
    uint i = order[j];
    uint slot = offsets[j];
    first_slots[i] = slot;
    uint end = slot + tile_counts[i];
    uvec2 tiles = view[0].tiles;
    vec4 g = geometry[i], s = shape[i];
    Footprint f = footprint_of(g.xy, origin(view[0]), vec3(g.zw, s.x), s.z);
    uvec2 rows = tile_rows(f, tiles);
    for (uint row = rows.x; row < rows.y; row++) {
        uvec2 columns = tile_columns(f, row, tiles);
        for (uint column = columns.x; column < columns.y && slot < end; column++, slot++) {
            keys[slot] = row * tiles.x + column;
            slots[slot] = slot;
            owners[slot] = i;
        }
    }
    // Compilers may round this shader and the counting one differently: slots left over go to a tile that is not there.
    for (; slot < end; slot++) {
        keys[slot] = tiles.x * tiles.y;
        slots[slot] = slot;
        owners[slot] = i;
    }
}
