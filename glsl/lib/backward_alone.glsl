// One subgroup walks a tile's list front to back once more, its pixels in registers; each splat's sums over those pixels are
// reduced across the subgroup, and one lane hands them in. For devices whose shared memory and barriers are dear.
#include "lib/lane_sum.glsl"

void walk_alone(uint tile, uvec2 corner) {
    uint lane = gl_SubgroupInvocationID;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        uint n = p * SUBGROUP + lane;
        begin(p, corner + uvec2(n % TILE, n / TILE));
    }
    uint start = starts[tile], end = starts[tile + 1];
    // Splats come in groups of the subgroup's size: each lane reads one of them and, in the end, writes its sums.
    uint first = start;
    for (; first < end && !subgroupAll(done()); first += SUBGROUP) {
        uint length = min(SUBGROUP, end - first);
        uint slot = slots[min(first + lane, end - 1)];
        uint i = owners[slot];
        vec4 my_geometry = geometry[i], my_shape = shape[i];
        vec2 my_colour = colour[i];
        vec3 my_position_sum = vec3(0), my_covariance_sum = vec3(0), my_colour_sum = vec3(0), my_response_sum = vec3(0);
        for (uint n = 0; n < length; n++) {
            vec4 g = subgroupShuffle(my_geometry, n), s = subgroupShuffle(my_shape, n);
            vec4 rgb1 = vec4(s.w, subgroupShuffle(my_colour, n), 1);
            vec3 k = vec3(g.zw, s.x);
            vec3 position_sum = vec3(0), covariance_sum = vec3(0), colour_sum = vec3(0), response_sum = vec3(0);
            [[unroll]] for (uint p = 0; p < PIXELS; p++) {
                vec2 d = centre[p] - g.xy;
                float u = k.x * d.x + k.y * d.y;
                float v = k.z * d.y;
                Share a = blend_again(p, u * u + v * v, s, rgb1);
                float hu = a.h * u, hv = a.h * v;
                position_sum += vec3(a.h, hu, hv);
                covariance_sum += vec3(hu * u, hu * v, hv * v);
                colour_sum += a.part * gradient[p].rgb;
                if (RESIDUAL) response_sum += vec3(a.part, a.alpha, a.part * gradient[p].a);
            }
            position_sum = lane_sum(position_sum);
            covariance_sum = lane_sum(covariance_sum);
            colour_sum = lane_sum(colour_sum);
            if (RESIDUAL) response_sum = lane_sum(response_sum);
            bool own = lane == n;
            my_position_sum = own ? position_sum : my_position_sum;
            my_covariance_sum = own ? covariance_sum : my_covariance_sum;
            my_colour_sum = own ? colour_sum : my_colour_sum;
            if (RESIDUAL) my_response_sum = own ? response_sum : my_response_sum;
        }
        if (lane < length) {
            float sums[SUMS_MOST] =
                float[](my_position_sum.x, my_position_sum.y, my_position_sum.z, my_colour_sum.r, my_covariance_sum.x, my_covariance_sum.y,
                        my_covariance_sum.z, my_colour_sum.g, my_colour_sum.b, my_response_sum.x, my_response_sum.y, my_response_sum.z);
            hand_in(slot, i, sums);
        }
    }
    // Splats behind the point where the last pixel ended are not drawn.
    for (uint n = first + lane; n < end; n += SUBGROUP) hand_in_nothing(slots[n]);
}
