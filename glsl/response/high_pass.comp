// The gradient of L = sum C (C - blur C) with its bracket held constant: C - blur C, the picture's own fine detail. The
// fourth component becomes the mean over the colours of |C - blur C|. It replaces the loss if there are no photos.
//
// The blur is a separable Gaussian whose weights are renormalised at the border; columns first, then rows. An
// invocation owns a run of RUN outputs, so that it adds each value to up to RUN sums.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"

/// Phase: blurs columns into scratch.
const uint COLUMNS = 0;
/// Phase: blurs rows, and writes the gradient.
const uint ROWS = 1;
/// Outputs per invocation.
const uint RUN = 8;

layout(constant_id = 2) const uint PHASE = COLUMNS;

layout(binding = 0, std430) readonly buffer Image { float image[]; };        // red, green, blue, alpha
layout(binding = 1, std430) buffer Scratch { float scratch[]; };             // 3 per pixel
layout(binding = 2, std430) writeonly buffer Gradient { float gradient[]; }; // red, green, blue, residual
layout(push_constant) uniform Push {
    uint width;
    uint height;
};

const int RADIUS = 6;
// Gaussian of sigma 2 over 13 samples, normalised.
const float WINDOW[13] = float[](0.0022181959, 0.0087731348, 0.0270231576, 0.0648251851, 0.1211093901, 0.1762131228,
                                 0.1996756275, 0.1762131228, 0.1211093901, 0.0648251851, 0.0270231576, 0.0087731348,
                                 0.0022181959);

vec3 value(uint pixel) {
    return PHASE == COLUMNS ? vec3(image[4 * pixel], image[4 * pixel + 1], image[4 * pixel + 2])
                      : ROW3(scratch, pixel);
}

void main() {
    uint lines = PHASE == COLUMNS ? width : height, length = PHASE == COLUMNS ? height : width;
    uint index = global_index();
    uint line = index % lines, start = index / lines * RUN;
    if (start >= length) return;
    vec4 sums[RUN];
    [[unroll]] for (uint o = 0; o < RUN; o++) sums[o] = vec4(0);
    for (int k = -RADIUS; k < int(RUN) + RADIUS; k++) {
        int at = int(start) + k;
        bool inside = at >= 0 && at < int(length);
        uint along = inside ? uint(at) : 0;
        vec4 v = inside ? vec4(value(PHASE == COLUMNS ? along * width + line : line * width + along), 1) : vec4(0);
        [[unroll]] for (int o = 0; o < int(RUN); o++) {
            int tap = k - o + RADIUS;
            sums[o] += tap >= 0 && tap <= 2 * RADIUS ? WINDOW[clamp(tap, 0, 2 * RADIUS)] * v : vec4(0);
        }
    }
    [[unroll]] for (uint o = 0; o < RUN; o++) {
        uint along = start + o;
        if (along >= length) return;
        uint pixel = PHASE == COLUMNS ? along * width + line : line * width + along;
        vec3 blurred = sums[o].rgb / sums[o].a;
        if (PHASE == COLUMNS) {
            [[unroll]] for (uint c = 0; c < 3; c++) scratch[3 * pixel + c] = blurred[c];
        } else {
            vec3 d = vec3(image[4 * pixel], image[4 * pixel + 1], image[4 * pixel + 2]) - blurred;
            [[unroll]] for (uint c = 0; c < 3; c++) gradient[4 * pixel + c] = d[c];
            gradient[4 * pixel + 3] = (abs(d.r) + abs(d.g) + abs(d.b)) / 3;
        }
    }
}
