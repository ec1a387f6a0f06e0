// Gradients of a tile's pixels by its splats, by one subgroup or by several that share the tile.
//
// The including shader includes lib/slot_sums.glsl and defines the destination of its sums, by hand_in(slot, Gaussian,
// sums) and hand_in_nothing(slot). It also defines RESIDUAL: true if the image gradient's fourth component is a
// residual, which weights contributions, instead of dL/dalpha.
layout(constant_id = 6) const uint BATCH = 0; // splats staged in shared memory at a time; 0 where one subgroup walks the tile

// For tests: the ninth sum of a slot is the number of subgroups that have drawn the splat.
layout(constant_id = 7) const bool COUNT_TAKERS = false;

#include "lib/backward_pixels.glsl"
#include "lib/backward_alone.glsl"
#include "lib/backward_together.glsl"

void main() {
    uvec2 tiles = view[0].tiles;
    uint tile = walked_tile(group_index(), tiles);
    if (tile >= tiles.x * tiles.y) return;
    uvec2 corner = uvec2(tile % tiles.x, tile / tiles.x) * TILE;
    if (BATCH == 0) walk_alone(tile, corner);
    else walk_together(tile, corner);
}
