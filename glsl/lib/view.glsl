// The camera in the kernels' form. Conventions: x right, y down, z forward; pixel centres at + 0.5.

/// Inside the projection's Jacobian x/z and y/z are clamped to this multiple of the half field of view's tangent
/// (3DGS's value), and beyond it only where the picture shows more on that side of the axis: further out the linearisation
/// would enlarge Gaussians excessively.
const float FIELD_MARGIN = 1.3;
/// The same about the middle of a picture that is not around the axis.
const float FIELD_BEYOND = 1.2;
/// Variance added to every splat of a plain model, in square pixels: the 3DGS reference's value, which every viewer of
/// such models uses.
const float DILATION = 0.3;
/// Variance added to every splat of an anti-aliased model, in square pixels: near a pixel's own, 1/12, as in
/// Mip-Splatting.
const float DILATION_ANTIALIAS = 0.1;
/// Gaussians nearer to the camera's plane than this are culled, in world units (3DGS's value).
const float NEAR = 0.2;

struct View {
    vec4 rotation[3];   // rows of world-to-camera; w: the camera's centre minus its rounded value
    vec4 centre;        // camera centre in world units, rounded; w: near plane
    vec4 background;    // red, green, blue; w unused
    vec2 focal;         // pixels
    vec2 principal;     // pixels from the origin
    vec2 tangent_limit; // the multiple of FIELD_MARGIN
    uvec2 size;         // pixels
    uvec2 tiles;        // columns, rows
    uint degree;        // SH degree in use
    float dilation;     // added to a splat's variance, in square pixels
    uvec2 whole;        // pixels of the whole picture, of which this may be a part
    uvec2 corner;       // upper left corner of this part in it, pixels
};

mat3 world_to_camera(View v) { return transpose(mat3(v.rotation[0].xyz, v.rotation[1].xyz, v.rotation[2].xyz)); }

// Origin of positions in the whole picture, in pixels from the upper left corner of this part. The error of a float32
// position is 6e-8 of its distance from the origin: almost zero near the middle, however wide the picture. Positions do
// not depend on the part, so that its pixels are those of the whole picture, bit for bit.
vec2 origin(View v) { return vec2(v.whole / 2u) - vec2(v.corner); }

// Bounds of x/z and y/z inside the projection's Jacobian. They are those of 3DGS up to a principal point 1/20 of the picture's
// width from its middle. Farther off, as in crops and faces of fisheyes, they lie FIELD_BEYOND / FIELD_MARGIN times half the
// picture from its middle.
vec2 least_slope(View v) { return min(-v.tangent_limit, -v.principal / v.focal - FIELD_BEYOND / FIELD_MARGIN * v.tangent_limit); }
vec2 most_slope(View v) { return max(v.tangent_limit, -v.principal / v.focal + FIELD_BEYOND / FIELD_MARGIN * v.tangent_limit); }

// Offset from the camera's centre to a world point: exact for near points, however far the scene lies from its origin.
vec3 from_centre(View v, vec3 point) {
    precise vec3 near = point - v.centre.xyz;
    precise vec3 exact = near - vec3(v.rotation[0].w, v.rotation[1].w, v.rotation[2].w);
    return exact;
}
