// The backward pass by one subgroup that walks a tile's list again.
#include "lib/tile_walk.glsl"

vec3 own_position_sum, own_covariance_sum, own_colour_sum, own_response_sum;

void forget() { own_position_sum = own_covariance_sum = own_colour_sum = own_response_sum = vec3(0); }

void visit(uint n, vec4 g, vec4 s, vec2 c) {
    vec4 rgb1 = vec4(s.w, c, 1);
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
    bool own = gl_SubgroupInvocationID == n;
    own_position_sum = own ? position_sum : own_position_sum;
    own_covariance_sum = own ? covariance_sum : own_covariance_sum;
    own_colour_sum = own ? colour_sum : own_colour_sum;
    if (RESIDUAL) own_response_sum = own ? response_sum : own_response_sum;
}

void hand_in_own(uint slot, uint gaussian) {
    float sums[SUMS_MOST] =
        float[](own_position_sum.x, own_position_sum.y, own_position_sum.z, own_colour_sum.r, own_covariance_sum.x, own_covariance_sum.y,
                own_covariance_sum.z, own_colour_sum.g, own_colour_sum.b, own_response_sum.x, own_response_sum.y, own_response_sum.z);
    hand_in(slot, gaussian, sums);
}
