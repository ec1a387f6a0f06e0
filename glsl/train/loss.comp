// L1 + SSIM (+ L2) of a picture against its photo, and the gradient by the picture. The window is separable and its sums
// run along columns, then rows, then once more for the gradient: an invocation owns a run of RUN outputs of one channel, so
// that each value read serves up to RUN sums out of registers.
//
// With m = E[x], e = E[xx], c = E[xy] under the window, SSIM's map s(m, e, c) gives
//   d(sum s)/dx = W(ds/dm) + 2 x W(ds/de) + y W(ds/dc), W being the same window, which is symmetric.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"

// 0 columns of the five means, 1 rows of them and the map, 2 columns of the three partial derivatives, 3 rows and the gradient
layout(constant_id = 2) const uint PHASE = 0;
// What a photo's fourth byte means: 0 nothing, 1 opacity, the photo lying over the background.
layout(constant_id = 3) const uint ALPHA = 0;

layout(binding = 0, std430) readonly buffer Image { float image[]; }; // RGBA
layout(binding = 1, std430) readonly buffer Photo { uint photo[]; }; // RGBA, 8 bits each
layout(binding = 2, std430) buffer Means { float means[]; };       // 5 planes of 3 channels
layout(binding = 3, std430) buffer Partials { float partials[]; }; // 6 planes of 3 channels: partials, then their columns
layout(binding = 4, std430) writeonly buffer Gradient { float gradient[]; }; // by RGBA
layout(binding = 5, std430) buffer Terms { vec4 terms[]; };        // by run: sums of |x - y|, s, (x - y)^2, 0
layout(push_constant) uniform Push {
    vec4 background;
    uint width;
    uint height;
    float l1;   // weights of the three terms, each over the number of values
    float ssim;
    float l2;
};

const uint RUN = 8;
const uint RADIUS = 5;
const float C1 = 1e-4;
const float C2 = 9e-4;
// Gaussian of sigma 1.5 over 11 samples, normalised.
const float WINDOW[11] = float[](0.0010283801, 0.0075987581, 0.0360007721, 0.1093606895, 0.2130055377, 0.2660117249,
                                 0.2130055377, 0.1093606895, 0.0360007721, 0.0075987581, 0.0010283801);

float rendered(uint pixel, uint channel) { return image[4 * pixel + channel]; }

float truth(uint pixel, uint channel) {
    uint word = photo[pixel];
    float value = float((word >> (8 * channel)) & 255u) / 255.0;
    if (ALPHA == 1) {
        float opacity = float(word >> 24) / 255.0;
        value = value * opacity + background[channel] * (1 - opacity);
    }
    return value;
}

// Lanes of a subgroup take neighbouring lines, a line being a column in phases 0 and 2, a row in 1 and 3.
struct Run {
    uint line;
    uint start;
    uint channel;
    bool there;
};

Run run_of(uint index, uint lines, uint length) {
    uint runs = (length + RUN - 1) / RUN;
    Run r;
    r.line = index % lines;
    r.start = index / lines % runs * RUN;
    r.channel = index / lines / runs;
    r.there = r.channel < 3;
    return r;
}

uint plane(uint p, uint channel) { return (p * 3 + channel) * width * height; }

void columns_of_means(Run r) {
    float sums[5][RUN];
    [[unroll]] for (uint o = 0; o < RUN; o++) [[unroll]] for (uint m = 0; m < 5; m++) sums[m][o] = 0;
    [[unroll]] for (uint k = 0; k < RUN + 2 * RADIUS; k++) {
        int row = int(r.start + k) - int(RADIUS);
        bool inside = row >= 0 && row < int(height);
        uint pixel = inside ? uint(row) * width + r.line : 0;
        float x = inside ? rendered(pixel, r.channel) : 0;
        float y = inside ? truth(pixel, r.channel) : 0;
        float values[5] = float[](x, y, x * x, y * y, x * y);
        [[unroll]] for (uint o = 0; o < RUN; o++) {
            if (k >= o && k - o <= 2 * RADIUS) [[unroll]] for (uint m = 0; m < 5; m++) sums[m][o] += WINDOW[k - o] * values[m];
        }
    }
    [[unroll]] for (uint o = 0; o < RUN; o++) {
        if (r.start + o < height) {
            [[unroll]] for (uint m = 0; m < 5; m++) means[plane(m, r.channel) + (r.start + o) * width + r.line] = sums[m][o];
        }
    }
}

void rows_and_map(Run r, uint index) {
    float sums[5][RUN];
    [[unroll]] for (uint o = 0; o < RUN; o++) [[unroll]] for (uint m = 0; m < 5; m++) sums[m][o] = 0;
    [[unroll]] for (uint k = 0; k < RUN + 2 * RADIUS; k++) {
        int column = int(r.start + k) - int(RADIUS);
        bool inside = column >= 0 && column < int(width);
        uint at = r.line * width + (inside ? uint(column) : 0);
        [[unroll]] for (uint m = 0; m < 5; m++) {
            float value = inside ? means[plane(m, r.channel) + at] : 0;
            [[unroll]] for (uint o = 0; o < RUN; o++) {
                if (k >= o && k - o <= 2 * RADIUS) sums[m][o] += WINDOW[k - o] * value;
            }
        }
    }
    vec4 total = vec4(0);
    [[unroll]] for (uint o = 0; o < RUN; o++) {
        if (r.start + o < width) {
            uint pixel = r.line * width + r.start + o;
            float mx = sums[0][o], my = sums[1][o];
            float vx = sums[2][o] - mx * mx, vy = sums[3][o] - my * my, cov = sums[4][o] - mx * my;
            float a = 2 * mx * my + C1, b = 2 * cov + C2;
            float c = mx * mx + my * my + C1, d = vx + vy + C2;
            float s = a * b / (c * d);
            // By m with the variances' own dependence on it, by e, by c.
            partials[plane(0, r.channel) + pixel] = (2 * my * (b - a) + 2 * mx * s * (c - d)) / (c * d);
            partials[plane(1, r.channel) + pixel] = -s / d;
            partials[plane(2, r.channel) + pixel] = 2 * a / (c * d);
            float difference = rendered(pixel, r.channel) - truth(pixel, r.channel);
            total += vec4(abs(difference), s, difference * difference, 0);
        }
    }
    terms[index] = total;
}

void columns_of_partials(Run r) {
    float sums[3][RUN];
    [[unroll]] for (uint o = 0; o < RUN; o++) [[unroll]] for (uint m = 0; m < 3; m++) sums[m][o] = 0;
    [[unroll]] for (uint k = 0; k < RUN + 2 * RADIUS; k++) {
        int row = int(r.start + k) - int(RADIUS);
        bool inside = row >= 0 && row < int(height);
        uint at = (inside ? uint(row) : 0) * width + r.line;
        [[unroll]] for (uint m = 0; m < 3; m++) {
            float value = inside ? partials[plane(m, r.channel) + at] : 0;
            [[unroll]] for (uint o = 0; o < RUN; o++) {
                if (k >= o && k - o <= 2 * RADIUS) sums[m][o] += WINDOW[k - o] * value;
            }
        }
    }
    [[unroll]] for (uint o = 0; o < RUN; o++) {
        if (r.start + o < height) {
            [[unroll]] for (uint m = 0; m < 3; m++) {
                partials[plane(3 + m, r.channel) + (r.start + o) * width + r.line] = sums[m][o];
            }
        }
    }
}

void rows_and_gradient(Run r) {
    float sums[3][RUN];
    [[unroll]] for (uint o = 0; o < RUN; o++) [[unroll]] for (uint m = 0; m < 3; m++) sums[m][o] = 0;
    [[unroll]] for (uint k = 0; k < RUN + 2 * RADIUS; k++) {
        int column = int(r.start + k) - int(RADIUS);
        bool inside = column >= 0 && column < int(width);
        uint at = r.line * width + (inside ? uint(column) : 0);
        [[unroll]] for (uint m = 0; m < 3; m++) {
            float value = inside ? partials[plane(3 + m, r.channel) + at] : 0;
            [[unroll]] for (uint o = 0; o < RUN; o++) {
                if (k >= o && k - o <= 2 * RADIUS) sums[m][o] += WINDOW[k - o] * value;
            }
        }
    }
    [[unroll]] for (uint o = 0; o < RUN; o++) {
        if (r.start + o < width) {
            uint pixel = r.line * width + r.start + o;
            float x = rendered(pixel, r.channel), y = truth(pixel, r.channel);
            float by_ssim = sums[0][o] + 2 * x * sums[1][o] + y * sums[2][o];
            gradient[4 * pixel + r.channel] = l1 * sign(x - y) - ssim * by_ssim + 2 * l2 * (x - y);
            if (r.channel == 0) gradient[4 * pixel + 3] = 0;
        }
    }
}

void main() {
    uint index = global_index();
    bool columns = PHASE == 0 || PHASE == 2;
    Run r = run_of(index, columns ? width : height, columns ? height : width);
    if (!r.there) return;
    if (PHASE == 0) columns_of_means(r);
    else if (PHASE == 1) rows_and_map(r, index);
    else if (PHASE == 2) columns_of_partials(r);
    else rows_and_gradient(r);
}
