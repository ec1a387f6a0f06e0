// Projects each Gaussian (Q1; EWA), evaluates its colour, and counts the tiles it touches.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/blending.glsl"
#include "lib/view.glsl"
#include "lib/sh.glsl"
#include "lib/splat.glsl"
#include "lib/tiles.glsl"
#include "lib/projection.glsl"

layout(constant_id = 4) const bool ANTIALIAS = false;
layout(constant_id = 5) const uint DEGREE = 3; // bands with arrays

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Means { float means[]; };
layout(binding = 3, std430) readonly buffer LogScales { float log_scales[]; };
layout(binding = 4, std430) readonly buffer Rotations { vec4 rotations[]; };
layout(binding = 5, std430) readonly buffer Logits { float logits[]; };
layout(binding = 6, std430) readonly buffer Sh0 { float sh0[]; };
layout(binding = 7, std430) readonly buffer Sh1 { float sh1[]; };
layout(binding = 8, std430) readonly buffer Sh2 { float sh2[]; };
layout(binding = 9, std430) readonly buffer Sh3 { float sh3[]; };
layout(binding = 10, std430) writeonly buffer Geometry { vec4 geometry[]; };
layout(binding = 11, std430) writeonly buffer Shape { vec4 shape[]; };
layout(binding = 12, std430) writeonly buffer Colour { vec2 colour[]; };
layout(binding = 13, std430) writeonly buffer Depth { uint depth[]; };
layout(binding = 14, std430) writeonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 15, std430) writeonly buffer Visible { uint visible[]; };

vec3 load3(uint i) { return ROW3(sh0, i); }

// The colour before the offset of 0.5 and the clamp at 0.
vec3 radiance(uint i, vec3 direction) {
    vec3 sum = SH_C0 * load3(i);
    if (DEGREE > 0 && view[0].degree > 0) {
        float b[3];
        sh_basis_1(direction, b);
        [[unroll]] for (uint m = 0; m < 3; m++) [[unroll]] for (uint c = 0; c < 3; c++) sum[c] += b[m] * sh1[9 * i + 3 * m + c];
    }
    if (DEGREE > 1 && view[0].degree > 1) {
        float b[5];
        sh_basis_2(direction, b);
        [[unroll]] for (uint m = 0; m < 5; m++) [[unroll]] for (uint c = 0; c < 3; c++) sum[c] += b[m] * sh2[15 * i + 3 * m + c];
    }
    if (DEGREE > 2 && view[0].degree > 2) {
        float b[7];
        sh_basis_3(direction, b);
        [[unroll]] for (uint m = 0; m < 7; m++) [[unroll]] for (uint c = 0; c < 3; c++) sum[c] += b[m] * sh3[21 * i + 3 * m + c];
    }
    return sum;
}

uint count_tiles(Splat s) {
    Footprint f = footprint_of(s.mean, origin(view[0]), s.k, s.cut);
    uvec2 rows = tile_rows(f, view[0].tiles);
    uint tiles = 0;
    for (uint row = rows.x; row < rows.y; row++) {
        uvec2 columns = tile_columns(f, row, view[0].tiles);
        tiles += columns.y - columns.x;
    }
    return tiles;
}

void main() {
    uint i = global_index();
    if (i >= count[0]) return;
    tile_counts[i] = 0;
    visible[i] = 0;

    vec3 mean = ROW3(means, i);
    vec3 log_scale = ROW3(log_scales, i);
    Projection p = project(view[0], mean, log_scale, rotations[i]);
    if (!p.there) return;

    float opacity = 1 / (1 + exp(-logits[i]));
    if (ANTIALIAS) opacity *= sqrt(max(p.det0 / p.det, MIN_ANTIALIAS));
    Splat s;
    s.cut = log2(ALPHA_MIN_INVERSE * opacity);
    if (nan(logits[i]) || !finite(s.cut) || s.cut <= 0) return;
    s.log2_opacity = log2(opacity);
    s.mean = p.mean;
    s.k = splat_factor(p);
    vec3 colour_or_less = radiance(i, p.direction) + 0.5;
    if (!finite(s.mean) || !finite(s.k) || !finite(colour_or_less) || s.k.x <= 0 || s.k.z <= 0) return;
    s.colour = max(vec3(0), colour_or_less);

    uint tiles = count_tiles(s);
    if (tiles == 0) return;
    geometry[i] = pack_geometry(s);
    shape[i] = pack_shape(s);
    colour[i] = pack_colour(s);
    depth[i] = floatBitsToUint(p.depth); // positive floats have the order of their bits
    tile_counts[i] = tiles;
    visible[i] = 1;
}
