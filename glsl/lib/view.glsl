// The camera as kernels see it. Conventions: x right, y down, z forward; pixel centres at + 0.5.
struct View {
    vec4 rotation[3];   // rows of world-to-camera; w unused
    vec4 centre;        // camera centre in world units; w: near plane
    vec4 background;    // red, green, blue; w unused
    vec2 focal;         // pixels
    vec2 principal;     // pixels
    vec2 tangent_limit; // bounds of x/z and y/z inside the projection's Jacobian
    uvec2 size;         // pixels
    uvec2 tiles;        // columns, rows
    uint degree;        // SH degree in use
    uint padding;
};

mat3 world_to_camera(View v) { return transpose(mat3(v.rotation[0].xyz, v.rotation[1].xyz, v.rotation[2].xyz)); }
