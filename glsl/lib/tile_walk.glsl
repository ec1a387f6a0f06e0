// One subgroup walks a tile's list front to back, its pixels in registers; lane n keeps splat n's sums over those
// pixels and hands them in. For devices on which shared memory and barriers are expensive.
#include "lib/lane_sum.glsl"
#include "lib/walked_tile.glsl"

// Begins pixel p of this invocation, at a position in the picture.
void begin(uint p, uvec2 at);
// Sets this lane's own sums to zero.
void forget();
// Sums splat n of the group over all pixels; lane n keeps the sums.
void visit(uint n, vec4 geometry, vec4 shape, vec2 colour);
// Stores this lane's own sums.
void hand_in_own(uint slot, uint gaussian);
// Stores zeros for a splat that no pixel draws.
void hand_in_nothing(uint slot);

void walk_alone(uint tile, uvec2 corner) {
    uint lane = gl_SubgroupInvocationID;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        uint n = p * SUBGROUP + lane;
        begin(p, corner + uvec2(n % TILE, n / TILE));
    }
    uint start = starts[tile], end = starts[tile + 1];
    // Splats come in groups of the subgroup's size: each lane reads one of them and, in the end, writes its sums.
    uint first = start;
    for (; first < end && !subgroupAll(done()); first += SUBGROUP) {
        uint length = min(SUBGROUP, end - first);
        uint slot = slots[min(first + lane, end - 1)];
        uint i = owners[slot];
        vec4 own_geometry = geometry[i], own_shape = shape[i];
        vec2 own_colour = colour[i];
        forget();
        for (uint n = 0; n < length; n++) {
            visit(n, subgroupShuffle(own_geometry, n), subgroupShuffle(own_shape, n), subgroupShuffle(own_colour, n));
        }
        if (lane < length) hand_in_own(slot, i);
    }
    // Splats behind the point where the last pixel ended are not drawn.
    for (uint n = first + lane; n < end; n += SUBGROUP) hand_in_nothing(slots[n]);
}

// Walks the tile of this workgroup, which is one subgroup.
void walk_own_tile() {
    uvec2 tiles = view[0].tiles;
    uint tile = walked_tile(group_index(), tiles);
    if (tile < tiles.x * tiles.y) walk_alone(tile, uvec2(tile % tiles.x, tile / tiles.x) * TILE);
}
