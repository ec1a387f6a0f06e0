// The gradient of a picture's loss by a small motion of everything that its camera sees: a turn about the camera's centre,
// and a shift, both in world axes. It is a sum over Gaussians: of (mean - centre) x (gradient by the mean) and of what a
// turn of the ellipsoid changes, and of the gradients by the mean. A turn of the camera leaves view directions, and with
// them colours, as they are, so what the mean's gradient has from its direction is taken out of the turn. Sums run in a
// fixed order: strided over Gaussians, a tree within a workgroup, then workgroup after workgroup.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"
#include "lib/rows.glsl"
#include "lib/view.glsl"
#include "lib/sh.glsl"
#include "lib/gradient_row.glsl"
#include "lib/adam.glsl"

/// Phase: each workgroup sums the gradients of its share of the Gaussians.
const uint PARTS = 0;
/// Phase: adds the workgroups' sums to the photo's, in one workgroup.
const uint TOTAL = 1;
/// Numbers of a motion: turn and shift.
const uint SIZE = 6;

layout(constant_id = 2) const uint PHASE = PARTS;
layout(constant_id = 3) const uint DEGREE = 3; // bands with arrays

layout(binding = 0, std430) readonly buffer Pairs { uint pairs[]; }; // 1: the largest number ever needed
layout(binding = 1, std430) readonly buffer Count { uint count[]; };
layout(binding = 2, std430) readonly buffer Rows { float rows[]; };
layout(binding = 3, std430) readonly buffer Means { float means[]; };
layout(binding = 4, std430) readonly buffer Rotations { float rotations[]; }; // w, x, y, z
layout(binding = 5, std430) buffer Partials { float partials[]; };            // workgroup x 6
layout(binding = 6, std430) buffer Gradients { float gradients[]; };          // photo x 6
layout(binding = 7, std430) readonly buffer Views { View view[]; };
layout(binding = 8, std430) readonly buffer Sh1 { float sh1[]; };
layout(binding = 9, std430) readonly buffer Sh2 { float sh2[]; };
layout(binding = 10, std430) readonly buffer Sh3 { float sh3[]; };
layout(push_constant) uniform Push {
    vec3 centre;
    uint photo;
    uint groups; // workgroups of the first phase
    uint pair_limit;
};

#include "lib/part_sums.glsl"
#include "lib/by_direction.glsl"

vec3 row3(uint at) { return vec3(rows[at], rows[at + 1], rows[at + 2]); }

// Gradient by a turn of a Gaussian with this quaternion, from that by the quaternion.
vec3 by_turn(vec4 q, vec4 g) {
    return 0.5 * vec3(-q.y * g.x + q.x * g.y - q.w * g.z + q.z * g.w,
                      -q.z * g.x + q.w * g.y + q.x * g.z - q.y * g.w,
                      -q.w * g.x - q.z * g.y + q.y * g.z + q.x * g.w);
}

void sum_parts() {
    vec3 turn = vec3(0), shift = vec3(0);
    for (uint i = global_index(); i < count[0]; i += groups * WORKGROUP) {
        uint row = ROW * i;
        if (rows[row + ROW_GOOD] == 0) continue;
        vec3 by_mean = row3(row + ROW_MEAN), by_colour = row3(row + ROW_COLOUR), d = row3(row + ROW_DIRECTION);
        uint r = row + ROW_ROTATION;
        vec3 from = ROW3(means, i) - centre;
        vec4 q = vec4(rotations[4 * i], rotations[4 * i + 1], rotations[4 * i + 2], rotations[4 * i + 3]);
        turn += cross(from, by_mean) - cross(d, gradient_by_direction(i, d, by_colour));
        turn += by_turn(q, vec4(rows[r], rows[r + 1], rows[r + 2], rows[r + 3]));
        shift += by_mean;
    }
    float own[SIZE] = float[](turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
    store_part(own);
}

void add_total() {
    uint lane = gl_LocalInvocationID.x;
    // If pairs did not fit, this iteration does not count.
    if (lane >= SIZE || pairs[1] > pair_limit) return;
    float sum = sum_of_parts(lane, groups);
    if (sane(sum)) gradients[SIZE * photo + lane] += sum;
}

void main() {
    if (PHASE == PARTS) sum_parts();
    else add_total();
}
