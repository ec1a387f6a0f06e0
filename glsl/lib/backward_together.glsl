// Several subgroups walk a tile's list front to back again, each for a block of the tile's pixels. A batch of splats is
// staged in shared memory. By one ballot for as many splats as it has lanes, each subgroup finds those that come near
// its block, walks only these, and skips those that none of its pixels draws. The sums of a splat over the lanes are
// formed all at once: every exchange between lanes halves the number of sums that a lane continues with. They meet in
// shared memory, where those of the subgroups are added in the order of subgroups.
#include "lib/ellipse.glsl"
#include "lib/blocks_of_tile.glsl"

const uint SUBGROUPS = WORKGROUP / SUBGROUP;
const uint STAGED = BATCH == 0 ? 1 : BATCH;
shared vec4 batch_geometry[STAGED];
shared vec4 batch_shape[STAGED];
shared vec2 batch_colour[STAGED];
// Written and read by the invocation that stages the splat.
shared uint batch_slot[STAGED];
shared uint batch_takers[STAGED]; // one bit for each subgroup that has drawn the splat
shared float batch_sums[BATCH == 0 ? 1 : SUBGROUPS * BATCH * SUMS];
shared bool finished[SUBGROUPS]; // by subgroup: true if all its pixels are done

// Number of sums that a lane has left after each exchange.
const uint LEFT_1 = (SUMS + 1) / 2, LEFT_2 = (LEFT_1 + 1) / 2, LEFT_3 = (LEFT_2 + 1) / 2, LEFT_4 = (LEFT_3 + 1) / 2;
const uint LEFT = SUBGROUP >= 16 ? LEFT_4 : SUBGROUP == 8 ? LEFT_3 : LEFT_2;
uint home[SUMS_MOST]; // indices of these sums

// Lanes that differ in one bit share their sums: the lower lane keeps the first `left`, the upper one the rest.
void exchange(inout float sums[SUMS_MOST], uint count, uint left, uint bit) {
    bool upper = (gl_SubgroupInvocationID & bit) != 0;
    [[unroll]] for (uint k = 0; k < left; k++) {
        // With an odd count the upper lane has one sum less, and its last value is unused.
        float low = sums[k], high = k + left < count ? sums[k + left] : low;
        sums[k] = (upper ? high : low) + subgroupShuffleXor(upper ? low : high, bit);
    }
}

// Sums over the subgroup; each lane ends with LEFT of them.
void sums_of_lanes(inout float sums[SUMS_MOST]) {
    exchange(sums, SUMS, LEFT_1, 1);
    exchange(sums, LEFT_1, LEFT_2, 2);
    if (SUBGROUP >= 8) exchange(sums, LEFT_2, LEFT_3, 4);
    if (SUBGROUP >= 16) exchange(sums, LEFT_3, LEFT_4, 8);
    [[unroll]] for (uint bit = 16; bit < SUBGROUP; bit *= 2) sums[0] += subgroupShuffleXor(sums[0], bit);
}

// Index of a lane's k-th sum; SUMS if there is none, or if another lane has it, too.
uint kept(uint k) {
    uint lane = gl_SubgroupInvocationID;
    bool real = lane < 16;
    if (SUBGROUP >= 16) { k += (lane & 8) != 0 ? LEFT_4 : 0; real = real && k < LEFT_3; }
    if (SUBGROUP >= 8) { k += (lane & 4) != 0 ? LEFT_3 : 0; real = real && k < LEFT_2; }
    k += (lane & 2) != 0 ? LEFT_2 : 0;
    real = real && k < LEFT_1;
    k += (lane & 1) != 0 ? LEFT_1 : 0;
    return real && k < SUMS ? k : SUMS;
}

// Blends a staged splat into this lane's pixels, if a pixel of the subgroup draws it, and stores the subgroup's sums.
bool take(uint n) {
    vec4 g = batch_geometry[n], s = batch_shape[n];
    vec3 k = vec3(g.zw, s.x);
    float down = centre[0].y - g.y;
    float v = k.z * down;
    float u[PIXELS], power[PIXELS];
    bool drawn = false;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        u[p] = k.x * (centre[p].x - g.x) + k.y * down;
        power[p] = u[p] * u[p] + v * v;
        drawn = draws(p, power[p], s.z) || drawn; // without a branch: all lanes meet in the vote
    }
    if (!subgroupAny(drawn)) return false;
    vec4 rgb1 = vec4(s.w, batch_colour[n], 1);
    vec3 along, tint, response;
    [[unroll]] for (uint p = 0; p < PIXELS; p++) {
        Share a = blend_again(p, power[p], s, rgb1);
        float hu = a.h * u[p];
        vec3 by_h = vec3(a.h, hu, hu * u[p]);
        vec3 by_part = a.part * gradient[p].rgb;
        vec3 by_residual = vec3(a.part, a.alpha, a.part * gradient[p].a);
        along = p == 0 ? by_h : along + by_h;
        tint = p == 0 ? by_part : tint + by_part;
        response = p == 0 ? by_residual : response + by_residual;
    }
    float hv = along.x * v;
    float sums[SUMS_MOST] = float[](along.x, along.y, hv, tint.r, along.z, along.y * v, hv * v, tint.g, tint.b, response.x,
                                    response.y, response.z);
    sums_of_lanes(sums);
    [[unroll]] for (uint k = 0; k < LEFT; k++) {
        if (home[k] < SUMS) batch_sums[(gl_SubgroupID * BATCH + n) * SUMS + home[k]] = sums[k];
    }
    return true;
}

// Walks a staged batch with one subgroup.
void walk_batch(uint length, vec2 low, vec2 high) {
    uint lane = gl_SubgroupInvocationID;
    for (uint first = 0; first < length && !subgroupAll(done()); first += SUBGROUP) {
        uint own = first + lane;
        vec4 g = batch_geometry[own], s = batch_shape[own];
        bool touches = ellipse_touches(g.xy, vec3(g.zw, s.x), s.z, low, high);
        uvec4 near = subgroupBallot(touches && own < length);
        bool taken = false;
        [[unroll]] for (uint w = 0; w < (SUBGROUP + 31) / 32; w++) {
            for (uint left = near[w]; left != 0; left &= left - 1) {
                uint n = 32 * w + findLSB(left);
                bool any = take(first + n);
                taken = taken || (any && lane == n);
            }
        }
        if (taken) atomicOr(batch_takers[own], 1u << gl_SubgroupID);
    }
}

void walk_together(uint tile, uvec2 corner) {
    uint invocation = gl_LocalInvocationID.x, lane = gl_SubgroupInvocationID, subgroup = gl_SubgroupID;
    uvec2 block = corner + block_corner(subgroup);
    [[unroll]] for (uint p = 0; p < PIXELS; p++) begin(p, block + block_pixel(lane, p));
    vec2 low = vec2(block) + 0.5 - origin(view[0]);
    vec2 high = low + vec2(BLOCK_WIDTH - 1, BLOCK_HEIGHT - 1);
    [[unroll]] for (uint k = 0; k < LEFT; k++) home[k] = kept(k);

    uint first = starts[tile], end = starts[tile + 1];
    bool ended = false;
    for (; first < end && !ended; first += BATCH) {
        uint length = min(BATCH, end - first);
        for (uint n = invocation; n < length; n += WORKGROUP) {
            uint slot = slots[first + n], i = owners[slot];
            batch_geometry[n] = geometry[i];
            batch_shape[n] = shape[i];
            batch_colour[n] = colour[i];
            batch_slot[n] = slot;
            batch_takers[n] = 0;
        }
        barrier();
        walk_batch(length, low, high);
        bool own = subgroupAll(done());
        if (subgroupElect()) finished[subgroup] = own;
        barrier();
        ended = true;
        for (uint s = 0; s < SUBGROUPS; s++) ended = ended && finished[s];
        for (uint n = invocation; n < length; n += WORKGROUP) {
            uint slot = batch_slot[n], takers = batch_takers[n];
            float sums[SUMS_MOST];
            [[unroll]] for (uint k = 0; k < SUMS_MOST; k++) sums[k] = 0;
            for (uint s = 0; s < SUBGROUPS; s++) {
                if ((takers >> s & 1) == 0) continue;
                [[unroll]] for (uint k = 0; k < SUMS; k++) sums[k] += batch_sums[(s * BATCH + n) * SUMS + k];
            }
            if (COUNT_TAKERS) sums[8] = float(bitCount(takers));
            hand_in(slot, owners[slot], sums);
        }
    }
    // Splats behind the point where the last pixel ended are not drawn.
    for (uint n = first + invocation; n < end; n += WORKGROUP) hand_in_nothing(slots[n]);
}
