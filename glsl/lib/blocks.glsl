// Tiles of the blocks' lower triangles, each stored as a block, and its first row and first column in one word.

/// A tile's first row is shifted left by this many bits.
const int ROW_SHIFT = 16;
/// Mask of the bits below, which hold its first column.
const uint COLUMN_MASK = 65535;
