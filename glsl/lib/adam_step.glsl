// A step of Adam for one parameter, shared by all its kernels.
#include "lib/adam.glsl"

/// Form: an Adam step.
const uint UPDATE = 0;
/// Form: the gradient is written into the first moment, and the parameter stays (tests).
const uint GRADIENT = 1;

// First and second moment after a gradient. Decays: of the first and second moment, each followed by 1 minus itself.
vec2 next_moments(vec2 moment, float gradient, vec4 decays) {
    moment.x = decays.x * moment.x + decays.y * gradient;
    moment.y = decays.z * moment.y + decays.w * gradient * gradient;
    return moment;
}

// Amount subtracted from a parameter. Corrections: 1 / (1 - decays.x^step) and 1 / sqrt(1 - decays.z^step).
float change(vec2 moment, float rate, vec2 correction) {
    return rate * (moment.x * correction.x) / (sqrt(moment.y) * correction.y + EPSILON);
}

// Attrition's addition to the gradient of an opacity logit.
float pressed(float logit, float pressure, float least_through) {
    return pressure / max(least_through, 1 / (1 + exp(logit)));
}
