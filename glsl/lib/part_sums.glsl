// Sums of SIZE numbers over the invocations of a dispatch, in a fixed order: a tree within a workgroup, then workgroup after
// workgroup. The includer defines SIZE, and `partials`, workgroup x SIZE.
shared float sums[SIZE * WORKGROUP];

// Adds up the numbers of a workgroup's invocations and stores them as its part; all of them call it.
void store_part(float own[SIZE]) {
    uint lane = gl_LocalInvocationID.x;
    [[unroll]] for (uint k = 0; k < SIZE; k++) sums[k * WORKGROUP + lane] = own[k];
    [[dont_unroll]] for (uint step = WORKGROUP / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) {
            [[dont_unroll]] for (uint k = 0; k < SIZE; k++) sums[k * WORKGROUP + lane] += sums[k * WORKGROUP + lane + step];
        }
    }
    if (lane == 0) {
        [[dont_unroll]] for (uint k = 0; k < SIZE; k++) partials[SIZE * group_index() + k] = sums[k * WORKGROUP];
    }
}

// The sum of number k over the parts of so many workgroups.
float sum_of_parts(uint k, uint groups) {
    float sum = 0;
    for (uint g = 0; g < groups; g++) sum += partials[SIZE * g + k];
    return sum;
}
