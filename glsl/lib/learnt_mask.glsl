// Learnt masks: each Gaussian has a score, which decides whether an iteration's picture shows it, and how its mask
// changes with the score. If masks are drawn (MaskGaussian), a random number per iteration is added to the score; if a
// threshold decides (Compact3DGS), none is.
#include "lib/random.glsl"

/// Scores up to this one are masked by the threshold: the logit of 0.01.
const float LEAST_SCORE = -4.59511985013459;

// A number with a standard logistic distribution: the difference of two Gumbel variables. Finite: within 17.4 of 0.
float logistic(uvec3 key) {
    uint h = hash(key.x ^ hash(key.y ^ hash(key.z ^ hash(4u))));
    float u = (float(h >> 9) + 0.5) / 8388608.0;
    return log(u) - log(1 - u);
}

// d sigmoid(x) / dx, which is 0 at both ends.
float slope_of_mask(float x) { return 1 / (1 + exp(-x)) / (1 + exp(x)); }
