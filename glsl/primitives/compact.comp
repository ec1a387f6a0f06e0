// Stream compaction: the indices whose flags are set, in order, each with its key. The last phase of a scan of the
// flags: only kept elements are written, and their number if blocks are few.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

layout(constant_id = 3) const uint ROWS = 16;
layout(constant_id = 5) const bool FEW_BLOCKS = false;

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer Flags { uint flags[]; }; // 0 or 1
layout(binding = 2, std430) readonly buffer Sums { uint sums[]; };
layout(binding = 3, std430) readonly buffer Keys { uint keys[]; };
layout(binding = 4, std430) writeonly buffer KeptKeys { uint kept_keys[]; };
layout(binding = 5, std430) writeonly buffer Kept { uint kept[]; };
layout(binding = 6, std430) buffer Value { uint value[]; }; // as in primitives/scan.comp
layout(binding = 7, std430) writeonly buffer Arguments { uint arguments[]; };
layout(push_constant) uniform Push { uint limit; uint sizes[4]; };

#include "lib/counts.glsl"
#include "lib/scan.glsl"

void main() {
    uint n = count[0];
    uint sum = 0;
    uint at = first_element();
    for (uint row = 0; row < ROWS; row++, at += SUBGROUP) sum += at < n ? flags[at] : 0;
    uint carry = before_run(sum) + before_block(n);
    if (group_index() * BLOCK >= n) return;
    at = first_element();
    for (uint row = 0; row < ROWS; row++, at += SUBGROUP) {
        uvec4 set = subgroupBallot(at < n && flags[at] != 0);
        if (subgroupInverseBallot(set)) {
            uint to = carry + subgroupBallotExclusiveBitCount(set);
            kept_keys[to] = keys[at];
            kept[to] = at;
        }
        carry += subgroupBallotBitCount(set);
    }
}
