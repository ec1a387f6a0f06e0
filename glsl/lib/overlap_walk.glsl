// All pairs of a block, one workgroup for each tile of SUBGROUP rows by COLUMNS columns of its lower triangle. Each
// lane owns a row. Columns are broadcast in turn, so that a Gaussian is read once for each tile.
//
// The including shader defines overlap(x, y): the normalised overlap of two Gaussians.
#include "lib/finite.glsl"
#include "lib/axes.glsl"
#include "lib/blocks.glsl"

layout(constant_id = 2) const uint COLUMNS = 64; // a multiple of SUBGROUP

layout(binding = 0, std430) readonly buffer Blocks { uvec4 blocks[]; }; // first member, m, offset in its batch's overlaps, -
layout(binding = 1, std430) readonly buffer Tiles { uvec2 tiles[]; };   // block, first row and first column: lib/blocks.glsl
layout(binding = 2, std430) readonly buffer AxesRows { vec4 axes[]; };  // four for each member of the batch: lib/axes.glsl
// Lower triangles, column by column without gaps (LAPACK's packed "L"), block after block.
layout(binding = 3, std430) writeonly buffer Overlaps { float overlaps[]; };
layout(push_constant) uniform Push {
    uint first_tile;
    uint tile_count;
    uint first_member;
};

const int LEAST_EXPONENT = -100; // the overlap with a Gaussian this much smaller is effectively 0

mat4 axes_row(uint n) { return mat4(axes[4 * n], axes[4 * n + 1], axes[4 * n + 2], axes[4 * n + 3]); }

float product(vec3 v) { return v.x * v.y * v.z; }

float overlap(Axes x, Axes y);

void main() {
    uint group = group_index();
    if (group >= tile_count) return;
    uvec2 tile = tiles[first_tile + group];
    uvec4 block = blocks[tile.x];
    uint m = block.y, base = block.x - first_member;
    uint lane = gl_SubgroupInvocationID;
    uint row = (tile.y >> ROW_SHIFT) + lane;
    uint first_column = tile.y & COLUMN_MASK;
    Axes own = unpack_axes(axes_row(base + min(row, m - 1)));
    uint end = min(min(first_column + COLUMNS, (tile.y >> ROW_SHIFT) + SUBGROUP), m);
    for (uint start = first_column; start < end; start += SUBGROUP) {
        mat4 round = axes_row(base + min(start + lane, m - 1));
        for (uint k = 0; k < SUBGROUP && start + k < end; k++) {
            uint column = start + k;
            mat4 other = mat4(subgroupBroadcast(round[0], k), subgroupBroadcast(round[1], k),
                              subgroupBroadcast(round[2], k), subgroupBroadcast(round[3], k));
            float n = column == row ? 1 : overlap(own, unpack_axes(other));
            if (column <= row && row < m) overlaps[block.z + column * (2 * m - column - 1) / 2 + row] = n;
        }
    }
}
