// The camera as kernels see it. Conventions: x right, y down, z forward; pixel centres at + 0.5.
struct View {
    vec4 rotation[3];   // rows of world-to-camera; w: what rounding took from the camera's centre
    vec4 centre;        // camera centre in world units, rounded; w: near plane
    vec4 background;    // red, green, blue; w unused
    vec2 focal;         // pixels
    vec2 principal;     // pixels from the origin
    vec2 tangent_limit; // bounds of x/z and y/z inside the projection's Jacobian
    uvec2 size;         // pixels
    uvec2 tiles;        // columns, rows
    uint degree;        // SH degree in use
    float dilation;     // added to a splat's variance, in square pixels
};

mat3 world_to_camera(View v) { return transpose(mat3(v.rotation[0].xyz, v.rotation[1].xyz, v.rotation[2].xyz)); }

// Where positions in the picture are measured from, in pixels from its upper left corner. Float32 knows a position to 6e-8 of
// its distance from there: near the middle to next to nothing, however wide the picture.
vec2 origin(View v) { return vec2(v.size / 2u); }

// From the camera's centre to a point in the world: exact where it matters, however far the scene lies from its origin.
vec3 from_centre(View v, vec3 point) {
    precise vec3 near = point - v.centre.xyz;
    precise vec3 exact = near - vec3(v.rotation[0].w, v.rotation[1].w, v.rotation[2].w);
    return exact;
}
