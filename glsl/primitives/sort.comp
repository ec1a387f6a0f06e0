// One pass of a stable least-significant-digit radix sort in three phases: count digits per block, scan the counts of each digit
// over the blocks, scatter.
// Within a block each rank unit (a subgroup, or one invocation where SERIAL) owns a contiguous run of keys, so that order
// among equal digits is order of position: the sort is stable, and the same on every device.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "lib/dispatch.glsl"

/// Phase: counts the digits of each block.
const uint COUNT_DIGITS = 0;
/// Phase: scans the counts of each digit over the blocks. A rank unit takes a digit.
const uint SCAN_DIGITS = 1;
/// Phase: scatters keys and values by the scanned counts.
const uint SCATTER = 2;

layout(constant_id = 2) const uint PHASE = COUNT_DIGITS;
layout(constant_id = 3) const uint ROWS = 16; // keys per invocation
layout(constant_id = 4) const uint DIGIT_BITS = 8;
// Whether each invocation ranks a run of its own, without ballots, which cost more than they save where lanes share one core.
layout(constant_id = 5) const bool SERIAL = false;

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer KeysIn { uint keys_in[]; };
layout(binding = 2, std430) readonly buffer ValuesIn { uint values_in[]; };
layout(binding = 3, std430) buffer Digits { uint digits[]; }; // [digit][block], then the total of each digit
layout(binding = 4, std430) writeonly buffer KeysOut { uint keys_out[]; };
layout(binding = 5, std430) writeonly buffer ValuesOut { uint values_out[]; };
layout(push_constant) uniform Push { uint shift; };

const uint RADIX = 1u << DIGIT_BITS;
const uint BLOCK = WORKGROUP * ROWS;
const uint UNITS = SERIAL ? WORKGROUP : WORKGROUP / SUBGROUP;
shared uint counters[UNITS * RADIX];
shared uint smaller[RADIX]; // keys with smaller digits

uint digit_of(uint key) { return (key >> shift) & (RADIX - 1); }

uint unit() { return SERIAL ? gl_LocalInvocationID.x : gl_SubgroupID; }

// Position of this invocation's key in a row.
uint position(uint row) {
    uint start = group_index() * BLOCK;
    return SERIAL ? start + gl_LocalInvocationID.x * ROWS + row
                  : start + (gl_SubgroupID * ROWS + row) * SUBGROUP + gl_SubgroupInvocationID;
}

void clear_counters() {
    for (uint i = gl_LocalInvocationID.x; i < UNITS * RADIX; i += WORKGROUP) counters[i] = 0;
    barrier();
}

// The lanes of this subgroup that hold the same digit, this one included. Lanes without a key stay out.
uvec4 peers(uint digit, bool there) {
    uvec4 same = subgroupBallot(there);
    for (uint bit = 0; bit < DIGIT_BITS; bit++) {
        bool set = ((digit >> bit) & 1) != 0;
        uvec4 vote = subgroupBallot(set);
        same &= set ? vote : ~vote;
    }
    return same;
}

// The number of keys with this digit that this unit has seen before this one.
uint rank(uint digit, bool there) {
    uint slot = unit() * RADIX + digit;
    if (SERIAL) {
        if (!there) return 0;
        uint seen = counters[slot];
        counters[slot] = seen + 1;
        return seen;
    }
    uvec4 same = peers(digit, there);
    uint before = subgroupBallotExclusiveBitCount(same);
    uint seen = there ? counters[slot] : 0;
    subgroupBarrier();
    if (there && before == 0) counters[slot] = seen + subgroupBallotBitCount(same);
    subgroupBarrier();
    return seen + before;
}

void count_digits(uint n) {
    clear_counters();
    for (uint row = 0; row < ROWS; row++) {
        uint at = position(row);
        bool there = at < n;
        rank(there ? digit_of(keys_in[at]) : 0, there);
    }
    barrier();
    uint blocks = (n + BLOCK - 1) / BLOCK;
    if (group_index() >= blocks) return;
    for (uint digit = gl_LocalInvocationID.x; digit < RADIX; digit += WORKGROUP) {
        uint sum = 0;
        for (uint u = 0; u < UNITS; u++) sum += counters[u * RADIX + digit];
        digits[digit * blocks + group_index()] = sum;
    }
}

void scan_digits(uint n) {
    uint digit = group_index() * UNITS + unit();
    if (digit >= RADIX) return;
    uint blocks = (n + BLOCK - 1) / BLOCK;
    uint row = digit * blocks;
    uint sum = 0;
    if (SERIAL) {
        for (uint block = 0; block < blocks; block++) {
            uint own = digits[row + block];
            digits[row + block] = sum;
            sum += own;
        }
    } else {
        for (uint first = 0; first < blocks; first += SUBGROUP) {
            uint block = first + gl_SubgroupInvocationID;
            uint own = block < blocks ? digits[row + block] : 0;
            uint inclusive = subgroupInclusiveAdd(own);
            if (block < blocks) digits[row + block] = sum + inclusive - own;
            sum += subgroupBroadcast(inclusive, SUBGROUP - 1);
        }
    }
    if (SERIAL || subgroupElect()) digits[RADIX * blocks + digit] = sum;
}

// One subgroup scans the digits' totals.
void scan_totals(uint blocks) {
    if (gl_SubgroupID != 0) return;
    uint carry = 0;
    for (uint first = 0; first < RADIX; first += SUBGROUP) {
        uint digit = first + gl_SubgroupInvocationID;
        uint own = digit < RADIX ? digits[RADIX * blocks + digit] : 0;
        uint inclusive = subgroupInclusiveAdd(own);
        if (digit < RADIX) smaller[digit] = carry + inclusive - own;
        carry += subgroupBroadcast(inclusive, SUBGROUP - 1);
    }
}

void scatter(uint n) {
    uint ranks[ROWS];
    uint blocks = (n + BLOCK - 1) / BLOCK;
    scan_totals(blocks);
    clear_counters();
    for (uint row = 0; row < ROWS; row++) {
        uint at = position(row);
        bool there = at < n;
        ranks[row] = rank(there ? digit_of(keys_in[at]) : 0, there);
    }
    barrier();
    if (group_index() >= blocks) return;
    for (uint digit = gl_LocalInvocationID.x; digit < RADIX; digit += WORKGROUP) {
        uint next = smaller[digit] + digits[digit * blocks + group_index()];
        for (uint u = 0; u < UNITS; u++) {
            uint own = counters[u * RADIX + digit];
            counters[u * RADIX + digit] = next;
            next += own;
        }
    }
    barrier();
    for (uint row = 0; row < ROWS; row++) {
        uint at = position(row);
        if (at < n) {
            uint key = keys_in[at];
            uint to = counters[unit() * RADIX + digit_of(key)] + ranks[row];
            keys_out[to] = key;
            values_out[to] = values_in[at];
        }
    }
}

void main() {
    uint n = count[0];
    if (PHASE == COUNT_DIGITS) count_digits(n);
    else if (PHASE == SCAN_DIGITS) scan_digits(n);
    else scatter(n);
}
