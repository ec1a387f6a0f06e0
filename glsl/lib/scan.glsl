// The parts of a scan that blocks have in common. Each subgroup owns a contiguous run of ROWS x SUBGROUP elements. A shader
// that includes this declares ROWS.

const uint SUBGROUPS = WORKGROUP / SUBGROUP;
const uint BLOCK = WORKGROUP * ROWS;
shared uint partial[SUBGROUPS];

// Sums over blocks saturate: a total beyond 32 bits must not pass for one that fits.
uint saturated(uint a, uint b) {
    uint sum = a + b;
    return sum < a ? 0xffffffff : sum;
}

// Sum of `partial` over the first `subgroups`.
uint before(uint subgroups) {
    uint sum = 0;
    for (uint s = 0; s < subgroups; s++) sum = saturated(sum, partial[s]);
    return sum;
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
