// The loss of loss.comp on tiles in shared memory: an invocation owns a pixel, a workgroup a tile with its margin. Rows of windows
// come first, then columns. Loops over windows are not unrolled, for compilers that cannot handle rings of registers.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
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

layout(binding = 0, std430) readonly buffer Image { vec4 image[]; }; // RGBA
layout(binding = 1, std430) readonly buffer Photo { uint photo[]; }; // RGBA, 8 bits each
layout(binding = 2, std430) buffer Partials { float partials[]; }; // by m, r, c: 3 planes of 3 channels
layout(binding = 3, std430) writeonly buffer Gradient { vec4 gradient[]; };
layout(binding = 4, std430) writeonly buffer Terms { vec4 terms[]; }; // sums of |x - y|, s, (x - y)^2, 0: tiles of MAP, then of GRADIENT
layout(push_constant) uniform Push {
    vec4 background;
    uint width;
    uint height;
    float l1;   // weights of the three terms, each divided by the number of values
    float ssim;
    float l2;
};

const uint SIDE = TILE + 2 * RADIUS; // of a tile with its margin
const uint AREA = SIDE * SIDE;
const uint ROW_AREA = SIDE * TILE; // of window means along rows
shared float values[3 * AREA];   // x and y in phase MAP, else by m, r, c
shared float along_rows[4 * ROW_AREA];

uint lane = gl_LocalInvocationID.x;

uint plane(uint p, uint channel) { return (p * 3 + channel) * width * height; }

// An invocation's pixels of the tile and its margin. It loads all of them before it waits for the first.
const uint OWN = (AREA + WORKGROUP - 1) / WORKGROUP;
vec4 own_image[OWN];
uint own_photo[OWN];

// The index in the picture of the n-th of these pixels; -1 outside the picture.
int own_pixel(ivec2 corner, uint n) {
    uint i = lane + n * WORKGROUP;
    ivec2 at = corner + ivec2(i % SIDE, i / SIDE) - int(RADIUS);
    bool inside = i < AREA && all(greaterThanEqual(at, ivec2(0))) && at.x < int(width) && at.y < int(height);
    return inside ? at.y * int(width) + at.x : -1;
}

void load_pictures(ivec2 corner) {
    [[unroll]] for (uint n = 0; n < OWN; n++) {
        int pixel = own_pixel(corner, n);
        own_image[n] = pixel < 0 ? vec4(0) : image[pixel];
        own_photo[n] = pixel < 0 ? 0 : photo[pixel];
    }
}

// The three planes of partial derivatives of a channel.
void load_partials(ivec2 corner, uint channel) {
    [[unroll]] for (uint n = 0; n < OWN; n++) {
        int pixel = own_pixel(corner, n);
        uint at = max(pixel, 0);
        vec3 by = vec3(partials[plane(0, channel) + at], partials[plane(1, channel) + at], partials[plane(2, channel) + at]);
        own_image[n].xyz = pixel < 0 ? vec3(0) : by;
    }
}

float truth(uint word, uint channel) { return photo_value(word, channel, ALPHA, background[channel]); }

// Stages a channel of the tile with its margin: zeros outside the picture.
void stage(ivec2 corner, uint channel) {
    [[unroll]] for (uint n = 0; n < OWN; n++) {
        uint i = lane + n * WORKGROUP;
        if (i >= AREA) continue;
        if (PHASE == MAP) {
            values[i] = own_image[n][channel];
            values[AREA + i] = own_pixel(corner, n) < 0 ? 0 : truth(own_photo[n], channel);
        } else {
            [[unroll]] for (uint p = 0; p < 3; p++) values[p * AREA + i] = own_image[n][p];
        }
    }
}

vec4 held(uint i) {
    float a = values[i], b = values[AREA + i];
    return PHASE == MAP ? vec4(a, b, (a - b) * (a - b), a * b) : vec4(a, b, values[2 * AREA + i], 0);
}

// Window means along rows: of x, y, (x - y)^2 and xy, or of the partial derivatives. Two neighbours per invocation.
void rows() {
    for (uint i = lane; i < ROW_AREA / 2; i += WORKGROUP) {
        uint first = 2 * i / TILE * SIDE + 2 * i % TILE;
        vec4 left = vec4(0), right = vec4(0), here = held(first);
        for (uint k = 0; k < TAPS; k++) {
            vec4 next = held(first + k + 1);
            left += WINDOW[k] * here;
            right += WINDOW[k] * next;
            here = next;
        }
        for (uint p = 0; p < (PHASE == MAP ? 4 : 3); p++) {
            along_rows[p * ROW_AREA + 2 * i] = left[p];
            along_rows[p * ROW_AREA + 2 * i + 1] = right[p];
        }
    }
}

// Window means of this invocation's pixel, from the means along rows.
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

// The sum of all invocations' terms, in a fixed order; only the first invocation has it.
vec2 summed(vec2 own) {
    barrier();
    along_rows[lane] = own.x;
    along_rows[WORKGROUP + lane] = own.y;
    barrier();
    for (uint step = WORKGROUP / 2; step >= SUBGROUP; step /= 2) {
        if (lane < step) {
            along_rows[lane] += along_rows[lane + step];
            along_rows[WORKGROUP + lane] += along_rows[WORKGROUP + lane + step];
        }
        barrier();
    }
    vec2 sum = vec2(along_rows[lane], along_rows[WORKGROUP + lane]);
    for (uint step = SUBGROUP / 2; step > 0; step /= 2) sum += subgroupShuffleDown(sum, step);
    return sum;
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
    vec4 slope = vec4(0), shown = vec4(0);
    uint word = 0;
    if (PHASE == MAP) {
        load_pictures(ivec2(corner));
    } else {
        load_partials(ivec2(corner), 0);
        shown = image[pixel];
        word = photo[pixel];
    }
    [[unroll]] for (uint channel = 0; channel < 3; channel++) {
        stage(ivec2(corner), channel);
        if (PHASE == GRADIENT && channel < 2) load_partials(ivec2(corner), channel + 1);
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
            float x = shown[channel], y = truth(word, channel);
            float by_ssim = mean.x + 2 * (x - y) * mean.y + y * mean.z;
            slope[channel] = l1 * sign(x - y) - ssim * by_ssim + 2 * l2 * (x - y);
            total += vec2(abs(x - y), (x - y) * (x - y));
        }
    }
    if (PHASE == GRADIENT && there) gradient[pixel] = slope;
    total = summed(total);
    if (lane == 0) terms[PHASE * tiles.x * tiles.y + tile] = PHASE == MAP ? vec4(0, total.x, 0, 0) : vec4(total.x, 0, total.y, 0);
}
