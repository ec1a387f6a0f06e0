// Backward pass of the projection: adds up a Gaussian's slots in their order and propagates back through covariance,
// mean and colour to one row of gradients, from which train/adam.comp updates the parameters. SH coefficients need no
// gradients of their own: each is the colour's gradient times the basis function.
//
// Notation and derivation: reference/project_backward.rs.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/view.glsl"
#include "lib/sh.glsl"
#include "lib/splat.glsl"
#include "lib/projection.glsl"
#include "lib/gradient_row.glsl"
#include "lib/adam.glsl"

layout(constant_id = 2) const bool ANTIALIAS = false;
layout(constant_id = 3) const uint DEGREE = 3; // bands with arrays
// True if the view direction's gradient reaches the mean.
layout(constant_id = 4) const bool DIRECTION_GRADIENT = true;
// True to add to the sums that density control uses.
layout(constant_id = 5) const bool STATISTICS = false;
// True if these sums add up the gradient's absolute value tile by tile, so that opposite gradients of tiles count, too.
layout(constant_id = 6) const bool ABSOLUTE = false;
// Slots from which a subgroup jointly adds up a Gaussian's, and invocations share the stores of rows; 0 if each works alone.
layout(constant_id = 7) const uint MANY = 0;
// True if the colours are depths, in red alone: red's gradient is that of the mean's depth, and what the picture before this one
// has left in the rows stays in the sum.
layout(constant_id = 8) const bool DEPTHS = false;

layout(binding = 0, std430) readonly buffer Views { View view[]; };
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 3, std430) readonly buffer TileCounts { uint tile_counts[]; };
layout(binding = 4, std430) readonly buffer FirstSlots { uint first_slots[]; };
layout(binding = 5, std430) readonly buffer PositionSums { vec4 position_sums[]; }; // by slot: 1, u, v, red
layout(binding = 6, std430) readonly buffer CovarianceSums { vec4 covariance_sums[]; }; // uu, uv, vv, green
layout(binding = 7, std430) readonly buffer BlueSums { float blue_sums[]; };
layout(binding = 8, std430) readonly buffer Shape { vec4 shape[]; };
layout(binding = 9, std430) readonly buffer Colour { vec2 colour[]; };
layout(binding = 10, std430) readonly buffer Means { float means[]; };
layout(binding = 11, std430) readonly buffer LogScales { float log_scales[]; };
layout(binding = 12, std430) readonly buffer Rotations { vec4 rotations[]; };
layout(binding = 13, std430) readonly buffer Logits { float logits[]; };
layout(binding = 14, std430) readonly buffer Sh1 { float sh1[]; };
layout(binding = 15, std430) readonly buffer Sh2 { float sh2[]; };
layout(binding = 16, std430) readonly buffer Sh3 { float sh3[]; };
layout(binding = 17, std430) buffer Rows { float rows[]; }; // lib/gradient_row.glsl
layout(binding = 18, std430) buffer Growth { vec2 growth[]; }; // sum of |dL/dmean2D| in NDC units, number of views that showed it
layout(binding = 19, std430) buffer Guards { uint guards[]; }; // 0: rows skipped, 1: iterations done
layout(push_constant) uniform Push { uint pair_limit; };

const float LEAST_SCALE = 1e-30; // a thinner axis has no gradient by its rotation
const float LN_2 = 0.6931471805599453;

const uint HALF = WORKGROUP / 2; // rows in shared memory at a time
shared float staged[MANY == 0 ? 1 : ROW * HALF];

bool sane(vec3 g) { return sane(g.x) && sane(g.y) && sane(g.z); }

struct Gradient {
    vec3 mean;
    vec3 log_scale;
    vec4 rotation;
    float logit;
    vec3 colour;    // by the radiance before its clamp
    vec3 direction; // unit vector of the view
    vec2 mean2d;    // pixels
    vec2 pull;      // with ABSOLUTE, the sum of absolute values; otherwise mean2d
};

// Let K = (k.x k.y; 0 k.z), so that K^T K is the inverse covariance, T = (row_x; row_y), S the second moments, and W = K T, whose
// columns are no longer than 1. Then dL/dT = K^T E with E = S W. Neither W nor E cancels, however long the needle. The usual
// product of dL/dcovariance and T equals it, but its error grows with the square of a needle's length in pixels.
struct Whitened {
    vec3 w_x, w_y;
    vec3 e_x, e_y;
};

Whitened whitened(float dilation, Projection p, vec3 k, float zeroth, vec3 second) {
    Whitened w;
    float c = p.covariance.z;
    // The bracket of w_x below is row_x - (b / c) row_y, since row_y x (row_x x row_y) = (row_y . row_y) row_x - (row_x . row_y) row_y.
    vec3 across = cross(p.row_y, p.normal);
    w.w_x = k.x * (across / (c * p.shrink * p.shrink) + (dilation / c) * p.row_x);
    w.w_y = k.z * p.row_y;
    w.e_x = second.x * w.w_x + second.y * w.w_y;
    w.e_y = second.y * w.w_x + second.z * w.w_y;
    if (ANTIALIAS && p.det0 > MIN_ANTIALIAS * p.det) {
        // d ln(det0 / det) / 2 = (Q0 - Q) / 2 = dilation Q Q0 / 2, where Q0 T is the transposed pseudo-inverse of T.
        float share = dilation * zeroth * p.shrink * p.shrink / p.det0;
        vec3 inverse_x = across, inverse_y = cross(p.normal, p.row_x);
        w.e_x += share * (k.x * inverse_x + k.y * inverse_y);
        w.e_y += share * (k.z * inverse_y);
    }
    return w;
}

// Gradient by the stored quaternion from the gradient `spin` by a rotation vector in the Gaussian's own axes: 2 q (0, spin),
// which is tangent to the unit sphere.
vec4 quaternion_gradient(vec3 spin, vec4 unit, float norm) {
    return 2 * vec4(-dot(unit.yzw, spin), unit.x * spin + cross(unit.yzw, spin)) / norm;
}

#include "lib/by_direction.glsl"

// The slots' sums are over u and v, in powers of two; with UNIT they and k are in natural units.
const float UNIT = sqrt(2 * LN_2);

// A Gaussian's slots added up; with ABSOLUTE, `pull` adds up the absolute values of their gradients by position.
struct Sums {
    vec4 position, covariance;
    float blue;
    vec2 pull;
};

const Sums NONE = Sums(vec4(0), vec4(0), 0, vec2(0));

Sums plus(Sums a, Sums b) {
    return Sums(a.position + b.position, a.covariance + b.covariance, a.blue + b.blue, a.pull + b.pull);
}

Sums plus_slot(Sums a, uint slot, vec3 k) {
    vec4 position = position_sums[slot];
    vec2 m = position.yz * UNIT;
    vec2 pull = ABSOLUTE ? abs(vec2(k.x * m.x, k.y * m.x + k.z * m.y)) : vec2(0);
    return plus(a, Sums(position, covariance_sums[slot], blue_sums[slot], pull));
}

Sums sums_alone(uint first, uint slots, vec3 k) {
    Sums s = NONE;
    for (uint slot = first; slot < first + slots; slot++) s = plus_slot(s, slot, k);
    return s;
}

// The sums of the lane whose number differs in this bit.
Sums of_lane(Sums s, uint bit) {
    return Sums(subgroupShuffleXor(s.position, bit), subgroupShuffleXor(s.covariance, bit), subgroupShuffleXor(s.blue, bit),
                ABSOLUTE ? subgroupShuffleXor(s.pull, bit) : vec2(0));
}

// Runs of a Gaussian's slots that are summed separately, for any subgroup size: slot n belongs to run n % RUNS.
const uint RUNS = 32;
const uint LANES = SUBGROUP < RUNS ? SUBGROUP : RUNS; // lanes with a run of their own; any further ones repeat these
const uint OWN_RUNS = RUNS / LANES;

// Every lane ends with the total.
Sums sums_together(uint first, uint slots, vec3 k) {
    Sums runs[OWN_RUNS];
    [[unroll]] for (uint r = 0; r < OWN_RUNS; r++) {
        runs[r] = NONE;
        for (uint n = r * LANES + gl_SubgroupInvocationID % LANES; n < slots; n += RUNS) runs[r] = plus_slot(runs[r], first + n, k);
        [[unroll]] for (uint bit = 1; bit < LANES; bit *= 2) runs[r] = plus(runs[r], of_lane(runs[r], bit));
    }
    [[unroll]] for (uint apart = 1; apart < OWN_RUNS; apart *= 2) {
        [[unroll]] for (uint r = 0; r + apart < OWN_RUNS; r += 2 * apart) runs[r] = plus(runs[r], runs[r + apart]);
    }
    return runs[0];
}

// The sums of an invocation's Gaussian. All invocations of a subgroup call it; `slots` is 0 for those without a Gaussian.
Sums sums_of(uint first, uint slots, vec3 k) {
    bool many = MANY > 0 && slots >= MANY;
    Sums s = many ? NONE : sums_alone(first, slots, k);
    if (MANY == 0) return s;
    uvec4 waiting = subgroupBallot(many);
    [[unroll]] for (uint w = 0; w < (SUBGROUP + 31) / 32; w++) {
        for (uint left = waiting[w]; left != 0; left &= left - 1) {
            uint lane = 32 * w + findLSB(left);
            Sums all = sums_together(subgroupShuffle(first, lane), subgroupShuffle(slots, lane), subgroupShuffle(k, lane));
            if (lane == gl_SubgroupInvocationID) s = all;
        }
    }
    return s;
}

// k: the splat's factor, in natural units.
Gradient backward(uint i, vec3 mean, Projection p, vec3 k, Sums s) {
    Gradient g = Gradient(vec3(0), vec3(0), vec4(0), 0, vec3(0), vec3(0, 0, 1), vec2(0), vec2(0));
    View v = view[0];
    vec2 m1 = s.position.yz * UNIT;
    vec3 m2 = s.covariance.xyz * (2 * LN_2);
    g.mean2d = vec2(k.x * m1.x, k.y * m1.x + k.z * m1.y);
    g.pull = ABSOLUTE ? s.pull : g.mean2d;
    Whitened w = whitened(v.dilation, p, k, s.position.x, m2);

    g.log_scale = w.e_x * w.w_x + w.e_y * w.w_y;
    // dL/d(rotation of the axes) = sum over rows of (s_k E_k) x (W_k / s_k).
    vec3 inverse = 1 / max(p.scale, vec3(LEAST_SCALE));
    vec3 spin = cross(w.e_x * p.scale, w.w_x * inverse) + cross(w.e_y * p.scale, w.w_y * inverse);
    g.rotation = quaternion_gradient(spin, p.unit, p.norm);

    // Through the Jacobian.
    float z = p.position.z;
    vec3 depth_row = vec3(dot(v.rotation[2].xyz, p.rotation[0]), dot(v.rotation[2].xyz, p.rotation[1]),
                          dot(v.rotation[2].xyz, p.rotation[2])) * p.scale;
    float along_x = dot(w.e_x, depth_row), along_y = dot(w.e_y, depth_row);
    vec2 slope = p.position.xy / z;
    vec2 free = vec2(greaterThanEqual(slope, least_slope(v))) * vec2(lessThanEqual(slope, most_slope(v)));
    vec2 by_slope = v.focal * (g.mean2d - free * vec2(k.x * along_x, k.y * along_x + k.z * along_y) / z);
    float by_z = -(dot(slope, by_slope) + g.log_scale.x + g.log_scale.y + g.log_scale.z) / z;
    if (DEPTHS) by_z += s.position.w;
    g.mean = vec3(by_slope / z, by_z) * world_to_camera(v);
    g.logit = s.position.x / (1 + exp(logits[i]));

    g.direction = p.direction;
    // A colour clamped to 0 has no slope.
    vec3 drawn = vec3(shape[i].w, colour[i]);
    g.colour = mix(vec3(0), vec3(s.position.w, s.covariance.w, s.blue), greaterThan(drawn, vec3(0)));
    if (DIRECTION_GRADIENT) {
        vec3 by_direction = gradient_by_direction(i, p.direction, g.colour);
        // Through the normalisation: the part along the direction has no effect.
        float distance = length(from_centre(v, mean));
        g.mean += (by_direction - p.direction * dot(p.direction, by_direction)) / distance;
    }
    return g;
}

// Stores a row for each invocation that has a Gaussian. If stores are shared, neighbouring invocations store
// neighbouring words: rows go through shared memory, those of half of the invocations at a time.
void store(uint i, bool there, float own[ROW]) {
    if (MANY == 0) {
        if (there) {
            [[unroll]] for (uint c = 0; c < ROW; c++) rows[ROW * i + c] = own[c];
        }
        return;
    }
    uint lane = gl_LocalInvocationID.x, first = (i - lane) * ROW, end = count[0] * ROW;
    [[unroll]] for (uint part = 0; part < 2; part++) {
        barrier();
        if (lane / HALF == part) {
            [[unroll]] for (uint c = 0; c < ROW; c++) staged[ROW * (lane % HALF) + c] = own[c];
        }
        barrier();
        for (uint n = lane; n < ROW * HALF; n += WORKGROUP) {
            uint to = first + part * ROW * HALF + n;
            if (to < end) rows[to] = staged[n];
        }
    }
}

void main() {
    uint i = global_index();
    // If pairs did not fit, no iteration counts, from this one until the host has made room.
    if (pairs[1] > pair_limit) return;
    if (i == 0 && !DEPTHS) guards[1] += 1;
    bool there = i < count[0];
    uint slots = there ? tile_counts[i] : 0;
    vec3 mean, k = vec3(0);
    Projection p;
    if (slots > 0) {
        mean = ROW3(means, i);
        vec3 log_scale = ROW3(log_scales, i);
        p = project(view[0], mean, log_scale, rotations[i]);
        k = splat_factor(p) * UNIT;
    }
    Sums s = sums_of(slots > 0 ? first_slots[i] : 0, slots, k);
    Gradient g = Gradient(vec3(0), vec3(0), vec4(0), 0, vec3(0), vec3(0, 0, 1), vec2(0), vec2(0));
    if (slots > 0) g = backward(i, mean, p, k, s);

    bool good = sane(g.mean) && sane(g.log_scale) && sane(g.rotation.xyz) && sane(g.rotation.w) && sane(g.logit) && sane(g.colour);
    if (!good) atomicAdd(guards[0], 1);
    // Gaussians that dropout or a mask hides were not seen.
    if (STATISTICS && good && slots > 0 && shape[i].z > 0) growth[i] += vec2(length(g.pull * 0.5 * vec2(view[0].whole)), 1);
    float own[ROW];
    [[unroll]] for (uint c = 0; c < 3; c++) {
        own[ROW_MEAN + c] = g.mean[c];
        own[ROW_LOG_SCALE + c] = g.log_scale[c];
        own[ROW_COLOUR + c] = g.colour[c];
        own[ROW_DIRECTION + c] = g.direction[c];
    }
    [[unroll]] for (uint c = 0; c < 4; c++) own[ROW_ROTATION + c] = g.rotation[c];
    own[ROW_LOGIT] = g.logit;
    own[ROW_GOOD] = good ? 1 : 0;
    if (DEPTHS && there) {
        [[unroll]] for (uint c = 0; c < ROW; c++) own[c] = rows[ROW * i + c] + (good && c < ROW_COLOUR ? own[c] : 0);
    }
    store(i, there, own);
}
