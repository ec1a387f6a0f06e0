// Responses: eight channels per Gaussian, first those of rendering, then those of optimisation; see docs/method.md.

/// Channels of a Gaussian's response.
const uint CHANNELS = 8;
/// Number of channels from rendering, which come first; the others come from the loss's gradients.
const uint RENDERING = 4;
