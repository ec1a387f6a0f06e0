// subgroupAdd. Small subgroups use shuffles: CPU devices run the built-in as a loop with one branch per lane.
vec4 lane_sum(vec4 x) {
    if (SUBGROUP != 8) return subgroupAdd(x);
    x += subgroupShuffleXor(x, 1);
    x += subgroupShuffleXor(x, 2);
    return x + subgroupShuffleXor(x, 4);
}

vec3 lane_sum(vec3 x) {
    if (SUBGROUP != 8) return subgroupAdd(x);
    x += subgroupShuffleXor(x, 1);
    x += subgroupShuffleXor(x, 2);
    return x + subgroupShuffleXor(x, 4);
}
