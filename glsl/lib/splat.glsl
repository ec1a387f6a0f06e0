// A projected Gaussian. With the 2D covariance (a b; b c) and d = pixel - mean, its density falls by a factor of
// 2^(u u + v v), where u = k.x d.x + k.y d.y and v = k.z d.y. This sum of squares is never negative, and it has none of the
// cancellation that the conic's three products show for needles.
struct Splat {
    vec2 mean;      // pixels from the view's origin
    vec3 k;         // sqrt(log2(e) / 2) times (sqrt(c / det), -(b / c) sqrt(c / det), 1 / sqrt(c))
    float log2_opacity;
    float cut;      // u u + v v at which alpha falls to 1/255: log2(255 opacity)
    vec3 colour;
};

vec4 pack_geometry(Splat s) { return vec4(s.mean, s.k.xy); }
vec4 pack_shape(Splat s) { return vec4(s.k.z, s.log2_opacity, s.cut, s.colour.r); }
vec2 pack_colour(Splat s) { return s.colour.gb; }

// u u + v v at a pixel centre.
float splat_distance(vec2 d, vec3 k) {
    float u = k.x * d.x + k.y * d.y;
    float v = k.z * d.y;
    return u * u + v * v;
}
