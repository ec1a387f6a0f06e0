// The fourth byte of a photo's pixels.

/// The fourth byte means nothing.
const uint OPAQUE = 0;
/// The fourth byte is the opacity of the photo over the background.
const uint OPACITY = 1;
