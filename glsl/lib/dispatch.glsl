// Workgroup sizes and positions; every kernel includes this first.
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_KHR_shader_subgroup_ballot : require
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_KHR_shader_subgroup_shuffle_relative : require
#extension GL_KHR_shader_subgroup_vote : require

layout(constant_id = 0) const uint WORKGROUP = 256;
layout(constant_id = 1) const uint SUBGROUP = 32; // filled in by the device
layout(constant_id = 100) const bool BACKWARDS = false; // filled in by the device, for tests
layout(local_size_x_id = 0) in;

// Index of this workgroup: long dispatches are laid out in two dimensions. Tests number the workgroups from the last
// one, to expose kernels that rely on their order; in two dimensions from the middle one down, then from the last one,
// so that surplus workgroups come before some others and after some.
uint group_index() {
    uint index = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    if (!BACKWARDS) return index;
    uint all = gl_NumWorkGroups.x * gl_NumWorkGroups.y;
    return (all + (gl_NumWorkGroups.y > 1 ? all / 2 : 0) - 1 - index) % all;
}

// Index of this invocation in the dispatch.
uint global_index() { return group_index() * WORKGROUP + gl_LocalInvocationID.x; }
