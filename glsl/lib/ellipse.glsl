// The ellipse where a splat's alpha falls to 1/255, and its part between two rows. For an offset d from its mean, a
// splat has u = k.x d.x + k.y d.y and v = k.z d.y (lib/splat.glsl); the ellipse is u u + v v <= cut.

// Cuts are widened by this factor, so that rounding here never drops a pixel that the rasteriser would draw.
const float CUT_MARGIN = 1.001;
const float PIXEL_MARGIN = 0.01;
const float POSITION_MARGIN = 2.4e-7; // relative error of a position: four roundings

vec2 position_margin(vec2 mean) { return PIXEL_MARGIN + POSITION_MARGIN * abs(mean); }

// The least and the greatest d.x of the part between low <= v <= high, where turn = k.y / k.z. That part is convex.
vec2 ellipse_columns(vec3 k, float cut, float turn, float low, float high) {
    float root = sqrt(cut);
    low = clamp(low, -root, root);
    high = clamp(high, -root, root);
    // The ellipse is rightmost at v = -extreme.
    float extreme = root * turn / sqrt(1 + turn * turn);
    float right = clamp(-extreme, low, high);
    float left = clamp(extreme, low, high);
    return vec2(-sqrt(max(0.0, cut - left * left)) - turn * left, sqrt(max(0.0, cut - right * right)) - turn * right) / k.x;
}

// False only if no point of the ellipse lies within the rectangle.
bool ellipse_touches(vec2 mean, vec3 k, float cut, vec2 low, vec2 high) {
    vec2 margin = position_margin(mean);
    float wide = cut * CUT_MARGIN;
    vec2 v = k.z * (vec2(low.y, high.y) - mean.y + vec2(-margin.y, margin.y));
    vec2 x = mean.x + ellipse_columns(k, wide, k.y / k.z, v.x, v.y) + vec2(-margin.x, margin.x);
    return !(v.x * abs(v.x) > wide || v.y * abs(v.y) < -wide || x.x > high.x || x.y < low.x);
}
