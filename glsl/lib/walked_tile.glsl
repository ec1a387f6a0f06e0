// The tile that a workgroup walks.
// CPU devices give each thread a run of neighbouring workgroups. In rows, that is one part of the picture, and the thread with the
// crowded part ends last; tiles STRIDE apart come from all of it.
layout(constant_id = 20) const uint STRIDE = 1; // up to 1: tiles in rows

// The index-th of n tiles: all whose number is a multiple of STRIDE, then all that are one more, and so on.
uint walked_tile(uint index, uint n) {
    if (STRIDE <= 1 || index >= n) return index;
    uint length = n / STRIDE, longer = n % STRIDE; // the first runs have one tile more
    uint longs = longer * (length + 1);
    if (index < longs) return index % (length + 1) * STRIDE + index / (length + 1);
    uint rest = index - longs;
    return rest % length * STRIDE + longer + rest / length;
}
