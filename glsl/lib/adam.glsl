// Constants of Adam, from the 3DGS reference implementation, and the gradients that it accepts.
#include "lib/finite.glsl"

/// Decay of the first moment.
const float BETA1 = 0.9;
/// Decay of the second moment.
const float BETA2 = 0.999;
/// Keeps the quotient finite; so small that gradients of 1e-12 still move their parameters.
const float EPSILON = 1e-15;
/// Larger gradients count as not finite: the second moment holds their squares in float32.
const float GREATEST_GRADIENT = 1e18;

bool sane(float gradient) { return within(gradient, GREATEST_GRADIENT); }
