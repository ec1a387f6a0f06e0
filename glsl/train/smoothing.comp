// 3D smoothing: no Gaussian becomes thinner than the photos can resolve. The photo that samples it most finely, at intervals of T
// (depth over focal length), shows no smaller detail, so the least scale is sqrt(0.2) T (Mip-Splatting's filter).
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/finite.glsl"
#include "lib/view.glsl"

/// Share of a photo's size: Gaussians within this distance beyond its border count as seen.
const float MARGIN = 0.15;
const float LOG_WIDTH = -0.8047189562170503; // ln sqrt(0.2), pixels

layout(binding = 0, std430) readonly buffer Views { View view[]; }; // of all training photos
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Means { float means[]; };
layout(binding = 3, std430) buffer LogScales { float log_scales[]; };
layout(push_constant) uniform Push {
    uint views;
};

void main() {
    uint i = global_index();
    if (i >= count[0]) return;
    vec3 mean = ROW3(means, i);
    float interval = 0;
    bool seen = false;
    for (uint k = 0; k < views; k++) {
        View v = view[k];
        vec3 p = world_to_camera(v) * from_centre(v, mean);
        vec2 pixel = v.focal * p.xy / p.z + v.principal + origin(v);
        vec2 size = vec2(v.size), border = MARGIN * size;
        bool inside = finite(p) && p.z > v.centre.w && all(greaterThanEqual(pixel, -border)) && all(lessThanEqual(pixel, size + border));
        float here = p.z / max(v.focal.x, v.focal.y);
        if (inside && (!seen || here < interval)) {
            interval = here;
            seen = true;
        }
    }
    if (!seen) return;
    float least = log(interval) + LOG_WIDTH;
    for (uint c = 0; c < 3; c++) {
        float log_scale = log_scales[3 * i + c];
        if (!nan(log_scale) && log_scale < least) log_scales[3 * i + c] = least;
    }
}
