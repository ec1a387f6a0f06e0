// The tile that a workgroup walks. CPU devices give each thread a run of neighbouring workgroups. With rows of tiles in
// order that is one part of the picture, and the thread with the crowded part ends last; rows STRIDE apart come from
// all of it. Neighbours in a row share splats in the cache.
layout(constant_id = 20) const uint STRIDE = 1; // in rows; up to 1: rows in order

// Tile number `index`: first the rows whose number is a multiple of STRIDE, then those that are one more, and so on.
uint walked_tile(uint index, uvec2 tiles) {
    uint row = index / tiles.x;
    if (STRIDE <= 1 || row >= tiles.y) return index;
    uint length = tiles.y / STRIDE, longer = tiles.y % STRIDE; // the first runs have one row more
    uint longs = longer * (length + 1);
    uint rest = row - longs;
    row = row < longs ? row % (length + 1) * STRIDE + row / (length + 1)
        : rest % max(1, length) * STRIDE + longer + rest / max(1, length);
    return row * tiles.x + index % tiles.x;
}
