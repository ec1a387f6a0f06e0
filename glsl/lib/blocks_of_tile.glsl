// Blocks of a tile that subgroups share: each subgroup of the workgroup owns one, so that all its lanes skip a splat
// that misses the block. The including shader defines TILE, and PIXELS, the pixels per invocation.

// A block has PIXELS x SUBGROUP pixels. Those of a lane lie in one row.
const uint BLOCK = PIXELS * SUBGROUP;
const uint BLOCK_WIDTH = BLOCK >= 128 ? 16 : BLOCK >= 32 ? 8 : BLOCK >= 8 ? 4 : 2;
const uint BLOCK_HEIGHT = BLOCK / BLOCK_WIDTH;
const uint BLOCK_APART = BLOCK_WIDTH > PIXELS ? BLOCK_WIDTH / PIXELS : 1; // columns between two pixels of a lane

// The first pixel of a subgroup's block, relative to the tile.
uvec2 block_corner(uint subgroup) {
    return uvec2(subgroup % (TILE / BLOCK_WIDTH) * BLOCK_WIDTH, subgroup / (TILE / BLOCK_WIDTH) * BLOCK_HEIGHT);
}

// A lane's p-th pixel, relative to the block.
uvec2 block_pixel(uint lane, uint p) { return uvec2(lane % BLOCK_APART + p * BLOCK_APART, lane / BLOCK_APART); }
