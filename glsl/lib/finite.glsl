// Tests for finite numbers, by their bits. Vulkan lets a driver assume that there is no NaN and no infinity: isnan and
// isinf may become false, and a comparison with a NaN, min, max and clamp may come out either way.

#ifndef FINITE
#define FINITE

// The bits of a float's exponent, all set if it is not finite; as a float they are infinity.
const uint EXPONENT_BITS = 0x7f800000;

uint magnitude_bits(float x) { return floatBitsToUint(x) & 0x7fffffff; }

bool finite(float x) { return magnitude_bits(x) < EXPONENT_BITS; }
bool finite(vec2 v) { return finite(v.x) && finite(v.y); }
bool finite(vec3 v) { return finite(v.xy) && finite(v.z); }
bool finite(vec4 v) { return finite(v.xyz) && finite(v.w); }

// Whether a number is NaN.
bool nan(float x) { return magnitude_bits(x) > EXPONENT_BITS; }

// |x| <= most, and false for NaN; most is positive. Magnitudes order as their bits do.
bool within(float x, float most) { return magnitude_bits(x) <= floatBitsToUint(most); }

#endif
