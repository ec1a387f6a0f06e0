// The parts that all blocks of a scan share. Each subgroup owns a contiguous run of ROWS x SUBGROUP elements. The including shader
// declares ROWS, FEW_BLOCKS and `sums`: of each block if blocks are few, otherwise of all previous blocks.

const uint SUBGROUPS = WORKGROUP / SUBGROUP;
const uint BLOCK = WORKGROUP * ROWS;
shared uint partial[SUBGROUPS];

// Sums over blocks saturate: a total beyond 32 bits must not appear to fit.
uint saturated(uint a, uint b) {
    uint sum = a + b;
    return sum < a ? 0xffffffff : sum;
}

// The sum of up to 65,536 words, from the sums of their halves.
uint saturated(uvec2 halves) {
    uint high = halves.y + (halves.x >> 16);
    return high > 0xffff ? 0xffffffff : (high << 16) + (halves.x & 0xffff);
}

uvec2 halves(uint word) { return uvec2(word & 0xffff, word >> 16); }

// Sum of `partial` over the first `subgroups`.
uint before(uint subgroups) {
    uint sum = 0;
    for (uint s = 0; s < subgroups; s++) sum = saturated(sum, partial[s]);
    return sum;
}

// Sum over the workgroup of one word of up to 32 bits per invocation.
uint sum_of_workgroup(uint sum) {
    sum = saturated(subgroupAdd(halves(sum)));
    if (subgroupElect()) partial[gl_SubgroupID] = sum;
    barrier();
    return before(SUBGROUPS);
}

// This invocation's element of the first row; the next row's is SUBGROUP further.
uint first_element() {
    return group_index() * BLOCK + gl_SubgroupID * SUBGROUP * ROWS + gl_SubgroupInvocationID;
}

// Given each invocation's sum over its rows, the sum of this block's elements before this subgroup's run.
uint before_run(uint sum) {
    sum = subgroupAdd(sum);
    if (subgroupElect()) partial[gl_SubgroupID] = sum;
    barrier();
    return before(gl_SubgroupID);
}

// The sum of the blocks before this one. If they are few, the last block also sets the total as a count.
uint before_block(uint n) {
    if (!FEW_BLOCKS) return group_index() * BLOCK < n ? sums[group_index()] : 0;
    uint sum = 0;
    for (uint at = gl_LocalInvocationID.x; at < group_index() && at * BLOCK < n; at += WORKGROUP) sum = saturated(sum, sums[at]);
    barrier(); // `partial` has been read
    sum = sum_of_workgroup(sum);
    uint first = group_index() * BLOCK;
    bool last = first < n ? n - first <= BLOCK : group_index() == 0;
    if (last && gl_LocalInvocationID.x == 0) set_count(first < n ? saturated(sum, sums[group_index()]) : 0, limit, sizes);
    return sum;
}
