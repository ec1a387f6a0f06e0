// Axes of a Gaussian for its overlaps: sorted by descending scale, in units of the power of two nearest the largest.

/// Share of the Gaussian's largest scale to which the others are raised: float32 cannot distinguish the overlaps of thinner discs.
const float SCALE_FLOOR = 1e-3;

struct Axes {
    mat3 rotation; // columns are the axes
    vec3 scale;    // standard deviations, in units of 2^exponent; the largest lies within [0.7, 1.5]
    vec3 mean;     // world units
    int exponent;
};

mat4 pack_axes(Axes a) {
    return mat4(vec4(a.rotation[0], a.scale.x), vec4(a.rotation[1], a.scale.y), vec4(a.rotation[2], a.scale.z),
                vec4(a.mean, float(a.exponent)));
}

Axes unpack_axes(mat4 m) {
    return Axes(mat3(m[0].xyz, m[1].xyz, m[2].xyz), vec3(m[0].w, m[1].w, m[2].w), m[3].xyz, int(m[3].w));
}

// 2^e to the last bit, e in -126..127.
float power_of_two(int e) { return uintBitsToFloat(uint(e + 127) << 23); }
