// Depth as a loss, by a second picture of the same lists: its reds are the depths of Gaussians along the camera's axis, so that red
// is the sum of w z over a pixel's shares w. With the measured depth d and the opacity A = sum of w, a pixel's loss is
// |red - d A| / d, the mean distance of what is drawn from the measured surface, as far as both sides do not cancel.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/view.glsl"

/// Phase: colours become depths.
const uint COLOURS = 0;
/// Phase: the gradient by the picture.
const uint GRADIENT = 1;

layout(constant_id = 2) const uint PHASE = COLOURS;

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 3, std430) readonly buffer Depth { uint depth[]; }; // of Gaussians, as bits
layout(binding = 4, std430) buffer Shape { vec4 shape[]; };
layout(binding = 5, std430) writeonly buffer Colour { vec2 colour[]; };
layout(binding = 6, std430) readonly buffer Image { vec4 image[]; };
layout(binding = 7, std430) readonly buffer Maps { float maps[]; };
layout(binding = 8, std430) writeonly buffer Gradient { vec4 gradient[]; };
layout(push_constant) uniform Push {
    uvec2 size;   // of the photo's map, pixels
    uint first;   // its first one
    float unit;   // of the map, in the world's
    float weight; // of a pixel
};

// Red and opacity against the depth measured: the gradient by both.
vec2 by_red_and_alpha(float red, float alpha, float measured) {
    float background = view[0].background.r;
    float sum = red - (1 - alpha) * background;
    float by_sum = weight * sign(sum - measured * alpha) / measured;
    return vec2(by_sum, by_sum * (background - measured));
}

void main() {
    uint i = global_index();
    if (PHASE == COLOURS) {
        if (i >= count[0] || tile_counts[i] == 0) return;
        shape[i].w = uintBitsToFloat(depth[i]);
        colour[i] = vec2(0);
        return;
    }
    uvec2 picture = view[0].size;
    if (i >= picture.x * picture.y) return;
    // The map's pixel around the middle of this one; the map is of the whole photo.
    uvec2 at = uvec2(i % picture.x, i / picture.x) + view[0].corner;
    uvec2 there = min((2 * at + 1) * size / (2 * view[0].whole), size - 1);
    float measured = maps[first + there.y * size.x + there.x] * unit;
    vec2 by = measured > 0 ? by_red_and_alpha(image[i].r, image[i].a, measured) : vec2(0);
    gradient[i] = vec4(by.x, 0, 0, by.y);
}
