// Counts in device memory, and the dispatch sizes that follow from them. A shader that sets one declares the buffers
// `value` and `arguments`.

/// Workgroups in one dimension of a dispatch: the minimum that Vulkan guarantees; more go into a second dimension.
const uint MAX_GROUPS = 65535;
/// The same in tests of other orders: small dispatches then have surplus workgroups, as long ones do.
const uint FEW_GROUPS = 67;

// Sets a count, and one triple of dispatch sizes for each of four group sizes. A count beyond its limit becomes 0, so
// that all later passes over it do nothing; the number needed is kept. A dispatch over no elements still has one
// workgroup, which may have a count to set.
void set_count(uint count, uint limit, uint sizes[4]) {
    value[1] = max(value[1], count);
    if (count > limit) count = 0;
    value[0] = count;
    for (uint i = 0; i < 4; i++) {
        uint groups = max(1, count / sizes[i] + (count % sizes[i] != 0 ? 1 : 0));
        uint most = BACKWARDS ? FEW_GROUPS : MAX_GROUPS;
        uint rows = (groups + most - 1) / most;
        arguments[3 * i] = BACKWARDS ? min(groups, most) : (groups + rows - 1) / rows;
        arguments[3 * i + 1] = rows;
        arguments[3 * i + 2] = 1;
    }
}
