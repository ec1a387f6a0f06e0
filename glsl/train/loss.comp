// L1 + SSIM (+ L2) of a picture against its photo, and the gradient by the picture. The window is separable: an invocation walks a
// run of one line of one channel with the last TAPS values in registers, so that it reads each value once.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/photo.glsl"
#include "lib/ssim.glsl"

/// Phase: the four window means along columns.
const uint MEANS = 0;
/// Phase: the window means along rows, SSIM's map, and its partial derivatives under the window along rows.
const uint MAP = 1;
/// Phase: the partial derivatives under the window along columns, and the gradient.
const uint GRADIENT = 2;

layout(constant_id = 2) const uint PHASE = MEANS;
// Meaning of the photo's fourth byte: lib/photo.glsl.
layout(constant_id = 3) const uint ALPHA = OPAQUE;
// Length of a run, in rounds of TAPS steps.
layout(constant_id = 4) const uint ROUNDS = 4;

layout(binding = 0, std430) readonly buffer Image { float image[]; }; // RGBA
layout(binding = 1, std430) readonly buffer Photo { uint photo[]; }; // RGBA, 8 bits each
layout(binding = 2, std430) buffer Means { float means[]; };       // m, n, r, c: 4 planes of 3 channels
layout(binding = 3, std430) buffer Partials { float partials[]; }; // rows of those by m, r, c: 3 planes of 3 channels
layout(binding = 4, std430) writeonly buffer Gradient { float gradient[]; }; // by RGBA
layout(binding = 5, std430) buffer Terms { vec4 terms[]; };        // sums of |x - y|, s, (x - y)^2, 0: runs of MAP, then of GRADIENT
layout(push_constant) uniform Push {
    vec4 background;
    uint width;
    uint height;
    float l1;   // weights of the three terms, each divided by the number of values
    float ssim;
    float l2;
    uint row_runs; // runs of MAP
};

// Sum under the window of a ring whose oldest value is at index `first`. Once loops are unrolled, constants index the rings.
#define TAP(ring, first, k) WINDOW[k] * ring[((first) + (k)) % TAPS]
#define WINDOWED(ring, first)                                                                                             \
    (TAP(ring, first, 0) + TAP(ring, first, 1) + TAP(ring, first, 2) + TAP(ring, first, 3) + TAP(ring, first, 4)          \
     + TAP(ring, first, 5) + TAP(ring, first, 6) + TAP(ring, first, 7) + TAP(ring, first, 8) + TAP(ring, first, 9)        \
     + TAP(ring, first, 10))

float rendered(uint pixel, uint channel) { return image[4 * pixel + channel]; }

float truth(uint pixel, uint channel) { return photo_value(photo[pixel], channel, ALPHA, background[channel]); }

// Lanes of a subgroup take neighbouring lines: rows in phase MAP, otherwise columns.
struct Run {
    uint line;
    int start;
    uint channel;
};

uint plane(uint p, uint channel) { return (p * 3 + channel) * width * height; }

void columns_of_means(Run run) {
    float x[TAPS], y[TAPS], r[TAPS], c[TAPS];
    uint pixels = width * height;
    int at = run.start - int(RADIUS);
    uint pixel = uint(at) * width + run.line; // wraps above the picture, where nothing is read
#define READ_PAIR(slot)                                                                                                   \
    bool inside = at >= 0 && at < int(height);                                                                            \
    x[slot] = inside ? rendered(pixel, run.channel) : 0;                                                                    \
    y[slot] = inside ? truth(pixel, run.channel) : 0;                                                                       \
    r[slot] = (x[slot] - y[slot]) * (x[slot] - y[slot]);                                                                      \
    c[slot] = x[slot] * y[slot];                                                                                          \
    at++;                                                                                                                 \
    pixel += width;
    [[unroll]] for (uint k = 0; k < TAPS - 1; k++) {
        READ_PAIR(k)
    }
    uint written = plane(0, run.channel) + uint(run.start) * width + run.line;
    for (uint round = 0; round < ROUNDS && at < int(height + RADIUS); round++) {
        [[unroll]] for (uint s = 0; s < TAPS; s++) {
            READ_PAIR((s + TAPS - 1) % TAPS)
            if (at <= int(height + RADIUS)) {
                means[written] = WINDOWED(x, s);
                means[written + 3 * pixels] = WINDOWED(y, s);
                means[written + 6 * pixels] = WINDOWED(r, s);
                means[written + 9 * pixels] = WINDOWED(c, s);
            }
            written += width;
        }
    }
}

void rows_and_map(Run run, uint index) {
    float m[TAPS], n[TAPS], r[TAPS], c[TAPS]; // columns of means
    float by_m[TAPS], by_r[TAPS], by_c[TAPS]; // partial derivatives
    uint pixels = width * height;
    int at = run.start - 2 * int(RADIUS);
    uint base = plane(0, run.channel) + run.line * width;
#define READ_MEANS(slot)                                                                                                  \
    bool inside = at >= 0 && at < int(width);                                                                             \
    uint read = base + uint(at);                                                                                          \
    m[slot] = inside ? means[read] : 0;                                                                                   \
    n[slot] = inside ? means[read + 3 * pixels] : 0;                                                                      \
    r[slot] = inside ? means[read + 6 * pixels] : 0;                                                                      \
    c[slot] = inside ? means[read + 9 * pixels] : 0;                                                                      \
    at++;
    [[unroll]] for (uint k = 0; k < TAPS - 1; k++) {
        READ_MEANS(k)
        by_m[k + 1] = by_r[k + 1] = by_c[k + 1] = 0;
    }
    float total = 0;
    int last = min(run.start + int(TAPS * (ROUNDS - 1)) + 1, int(width)); // one past this run's last output
    for (uint round = 0; round < ROUNDS && at < int(width) + 2 * int(RADIUS); round++) {
        [[unroll]] for (uint s = 0; s < TAPS; s++) {
            READ_MEANS((s + TAPS - 1) % TAPS)
            int centre = at - 1 - int(RADIUS);
            Ssim at_centre = ssim_of(WINDOWED(m, s), WINDOWED(n, s), WINDOWED(r, s), WINDOWED(c, s));
            bool there = centre >= 0 && centre < int(width);
            by_m[s] = there ? at_centre.by_m : 0;
            by_r[s] = there ? at_centre.by_r : 0;
            by_c[s] = there ? at_centre.by_c : 0;
            if (centre >= run.start && centre < last) total += at_centre.map;
            int output_at = centre - int(RADIUS);
            if (output_at >= run.start && output_at < last) {
                uint written = base + uint(output_at);
                partials[written] = WINDOWED(by_m, s + 1);
                partials[written + 3 * pixels] = WINDOWED(by_r, s + 1);
                partials[written + 6 * pixels] = WINDOWED(by_c, s + 1);
            }
        }
    }
    terms[index] = vec4(0, total, 0, 0);
}

void columns_and_gradient(Run run, uint index) {
    float by_m[TAPS], by_r[TAPS], by_c[TAPS];
    uint pixels = width * height;
    int at = run.start - int(RADIUS);
    uint read = plane(0, run.channel) + uint(at) * width + run.line;
#define READ_PARTIALS(slot)                                                                                               \
    bool inside = at >= 0 && at < int(height);                                                                            \
    by_m[slot] = inside ? partials[read] : 0;                                                                             \
    by_r[slot] = inside ? partials[read + 3 * pixels] : 0;                                                                \
    by_c[slot] = inside ? partials[read + 6 * pixels] : 0;                                                                \
    at++;                                                                                                                 \
    read += width;
    [[unroll]] for (uint k = 0; k < TAPS - 1; k++) {
        READ_PARTIALS(k)
    }
    vec2 total = vec2(0);
    uint pixel = uint(run.start) * width + run.line;
    for (uint round = 0; round < ROUNDS && at < int(height + RADIUS); round++) {
        [[unroll]] for (uint s = 0; s < TAPS; s++) {
            READ_PARTIALS((s + TAPS - 1) % TAPS)
            if (at <= int(height + RADIUS)) {
                float x = rendered(pixel, run.channel), y = truth(pixel, run.channel);
                float by_ssim = WINDOWED(by_m, s) + 2 * (x - y) * WINDOWED(by_r, s) + y * WINDOWED(by_c, s);
                gradient[4 * pixel + run.channel] = l1 * sign(x - y) - ssim * by_ssim + 2 * l2 * (x - y);
                if (run.channel == 0) gradient[4 * pixel + 3] = 0;
                total += vec2(abs(x - y), (x - y) * (x - y));
            }
            pixel += width;
        }
    }
    terms[row_runs + index] = vec4(total.x, 0, total.y, 0);
}

void main() {
    uint index = global_index();
    bool rows = PHASE == MAP;
    uint lines = rows ? height : width, length_of_line = rows ? width : height;
    // Rows are shorter by a window: the map's partial derivatives extend that much further than the outputs.
    uint length_of_run = rows ? TAPS * (ROUNDS - 1) + 1 : TAPS * ROUNDS;
    uint runs = (length_of_line + length_of_run - 1) / length_of_run;
    Run run = Run(index % lines, int(index / lines % runs * length_of_run), index / lines / runs);
    if (run.channel >= 3) return;
    if (PHASE == MEANS) columns_of_means(run);
    else if (PHASE == MAP) rows_and_map(run, index);
    else columns_and_gradient(run, index);
}
