// Sums over a tile's pixels that the rasterisation's backward pass writes for each (tile, Gaussian) slot, in the order
// of their numbers. With h = alpha dL/dalpha: h, h u, h v, red, h u u, h u v, h v v, green, blue; then T alpha, alpha,
// T alpha x residual. Colours are the gradient by the Gaussian's colour.

/// Sums of a slot.
const uint SLOT_SUMS = 9;
/// Further sums of a slot, for responses.
const uint SLOT_RESPONSES = 3;
const uint SUMS_MOST = 12;
