// Tiles of the blocks' lower triangles: each is a block, and its first row and first column in one word.

/// A tile's first row is shifted left by this many bits.
const int ROW_SHIFT = 16;
/// The bits below hold its first column.
const uint COLUMN_MASK = 65535;
