// The loss of loss.comp on tiles in shared memory: an invocation owns a pixel, a workgroup a tile with its margin. Rows of
// windows come first, then columns. Loops are short and rolled, for compilers that do not finish rings of registers.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"
#include "lib/photo.glsl"
#include "lib/ssim.glsl"

/// Phase: SSIM's map and its partial derivatives.
const uint MAP = 0;
/// Phase: the partial derivatives under the window, and the gradient.
const uint GRADIENT = 1;

layout(constant_id = 2) const uint PHASE = MAP;
// Meaning of the photo's fourth byte: lib/photo.glsl.
layout(constant_id = 3) const uint ALPHA = OPAQUE;
layout(constant_id = 4) const uint TILE = 16; // side in pixels; WORKGROUP = TILE x TILE

layout(binding = 0, std430) readonly buffer Image { float image[]; }; // RGBA
layout(binding = 1, std430) readonly buffer Photo { uint photo[]; }; // RGBA, 8 bits each
layout(binding = 2, std430) buffer Partials { float partials[]; }; // by m, r, c: 3 planes of 3 channels
layout(binding = 3, std430) writeonly buffer Gradient { vec4 gradient[]; };
layout(binding = 4, std430) writeonly buffer Terms { vec4 terms[]; }; // sums of |x - y|, s, (x - y)^2, 0: tiles of MAP, then of GRADIENT
layout(push_constant) uniform Push {
    vec4 background;
    uint width;
    uint height;
    float l1;   // weights of the three terms, each over the number of values
    float ssim;
    float l2;
};

const uint SIDE = TILE + 2 * RADIUS; // of a tile with its margin
const uint AREA = SIDE * SIDE;
const uint ROW_AREA = SIDE * TILE; // of window means along rows
shared float values[3 * AREA];   // x and y in phase MAP, else by m, r, c
shared float along_rows[4 * ROW_AREA];

uint lane = gl_LocalInvocationID.x;

float rendered(uint pixel, uint channel) { return image[4 * pixel + channel]; }

float truth(uint pixel, uint channel) { return photo_value(photo[pixel], channel, ALPHA, background[channel]); }

uint plane(uint p, uint channel) { return (p * 3 + channel) * width * height; }

// Loads a tile with its margin: zeros outside the picture.
void load(ivec2 corner, uint channel) {
    for (uint i = lane; i < AREA; i += WORKGROUP) {
        ivec2 at = corner + ivec2(i % SIDE, i / SIDE) - int(RADIUS);
        bool inside = all(greaterThanEqual(at, ivec2(0))) && at.x < int(width) && at.y < int(height);
        uint pixel = inside ? uint(at.y) * width + uint(at.x) : 0;
        if (PHASE == MAP) {
            values[i] = inside ? rendered(pixel, channel) : 0;
            values[AREA + i] = inside ? truth(pixel, channel) : 0;
        } else {
            for (uint p = 0; p < 3; p++) values[p * AREA + i] = inside ? partials[plane(p, channel) + pixel] : 0;
        }
    }
}

// Window means along rows: of x, y, (x - y)^2 and xy, or of the partial derivatives.
void rows() {
    for (uint i = lane; i < ROW_AREA; i += WORKGROUP) {
        uint first = i / TILE * SIDE + i % TILE;
        vec4 sum = vec4(0);
        for (uint k = 0; k < TAPS; k++) {
            float a = values[first + k], b = values[AREA + first + k];
            vec4 held = PHASE == MAP ? vec4(a, b, (a - b) * (a - b), a * b) : vec4(a, b, values[2 * AREA + first + k], 0);
            sum += WINDOW[k] * held;
        }
        for (uint p = 0; p < (PHASE == MAP ? 4 : 3); p++) along_rows[p * ROW_AREA + i] = sum[p];
    }
}

// Window means of this invocation's pixel, from those along rows.
vec4 columns() {
    vec4 sum = vec4(0);
    for (uint k = 0; k < TAPS; k++) {
        uint at = lane + k * TILE;
        vec4 held = vec4(along_rows[at], along_rows[ROW_AREA + at], along_rows[2 * ROW_AREA + at], 0);
        if (PHASE == MAP) held.w = along_rows[3 * ROW_AREA + at];
        sum += WINDOW[k] * held;
    }
    return sum;
}

// The sum of all invocations' terms, in a fixed order; the first invocation has it.
vec2 summed(vec2 own) {
    barrier();
    along_rows[lane] = own.x;
    along_rows[WORKGROUP + lane] = own.y;
    for (uint step = WORKGROUP / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) {
            along_rows[lane] += along_rows[lane + step];
            along_rows[WORKGROUP + lane] += along_rows[WORKGROUP + lane + step];
        }
    }
    return vec2(along_rows[0], along_rows[WORKGROUP]);
}

void main() {
    uvec2 tiles = (uvec2(width, height) + TILE - 1) / TILE;
    uint tile = group_index();
    if (tile >= tiles.x * tiles.y) return;
    uvec2 corner = uvec2(tile % tiles.x, tile / tiles.x) * TILE;
    uvec2 at = corner + uvec2(lane % TILE, lane / TILE);
    bool there = at.x < width && at.y < height;
    uint pixel = there ? at.y * width + at.x : 0;
    vec2 total = vec2(0);
    vec4 slope = vec4(0);
    for (uint channel = 0; channel < 3; channel++) {
        load(ivec2(corner), channel);
        barrier();
        rows();
        barrier();
        vec4 mean = columns();
        if (PHASE == MAP) {
            Ssim s = ssim_of(mean.x, mean.y, mean.z, mean.w);
            if (there) {
                partials[plane(0, channel) + pixel] = s.by_m;
                partials[plane(1, channel) + pixel] = s.by_r;
                partials[plane(2, channel) + pixel] = s.by_c;
                total.x += s.map;
            }
        } else if (there) {
            float x = rendered(pixel, channel), y = truth(pixel, channel);
            float by_ssim = mean.x + 2 * (x - y) * mean.y + y * mean.z;
            slope[channel] = l1 * sign(x - y) - ssim * by_ssim + 2 * l2 * (x - y);
            total += vec2(abs(x - y), (x - y) * (x - y));
        }
    }
    if (PHASE == GRADIENT && there) gradient[pixel] = slope;
    total = summed(total);
    if (lane == 0) terms[PHASE * tiles.x * tiles.y + tile] = PHASE == MAP ? vec4(0, total.x, 0, 0) : vec4(total.x, 0, total.y, 0);
}
