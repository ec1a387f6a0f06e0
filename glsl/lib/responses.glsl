// Responses: eight channels for each Gaussian, first those of rendering, then those of optimisation; see docs/method.md.

/// Channels of a Gaussian's response.
const uint CHANNELS = 8;
/// The first channels, which rendering gives; the loss's gradients give the others.
const uint RENDERING = 4;
