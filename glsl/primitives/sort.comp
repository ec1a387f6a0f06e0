// One pass of a stable least-significant-digit radix sort in three phases: count digits per block, scan the counts of
// each digit over the blocks, scatter. If blocks are few, every block of the last phase sums the counts of all previous
// ones, and the second phase is left out: on a GPU, starting it takes longer. Within a block each rank unit (a
// subgroup, or one invocation if SERIAL) owns a contiguous run of keys, so that the order among equal digits is the
// order of position: the sort is stable, and equal on every device.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/dispatch.glsl"

/// Phase: counts the digits of each block.
const uint COUNT_DIGITS = 0;
/// Phase: scans the counts of each digit over the blocks, one rank unit per digit.
const uint SCAN_DIGITS = 1;
/// Phase: scatters keys and values by the scanned counts.
const uint SCATTER = 2;

layout(constant_id = 2) const uint PHASE = COUNT_DIGITS;
layout(constant_id = 3) const uint ROWS = 16; // keys per invocation, unless SERIAL
layout(constant_id = 4) const uint DIGIT_BITS = 8; // the most bits, if SERIAL
// True if each invocation ranks a run of its own, without ballots, which cost more than they save if lanes share one core.
layout(constant_id = 5) const bool SERIAL = false;
layout(constant_id = 6) const bool FEW_BLOCKS = false; // true if there is no second phase
// True if a block first sorts its own keys in shared memory, so that neighbouring invocations write neighbouring words.
layout(constant_id = 7) const bool STAGED = false;

layout(binding = 0, std430) readonly buffer Count { uint count[]; };
layout(binding = 1, std430) readonly buffer KeysIn { uint keys_in[]; };
layout(binding = 2, std430) readonly buffer ValuesIn { uint values_in[]; };
layout(binding = 3, std430) buffer Digits { uint digits[]; }; // [digit][block], then the total of each digit; [block][digit] if FEW_BLOCKS
layout(binding = 4, std430) writeonly buffer KeysOut { uint keys_out[]; };
layout(binding = 5, std430) writeonly buffer ValuesOut { uint values_out[]; };
// If SERIAL, the loops over rows and digits are of any length: one kernel is compiled for all sorts.
layout(push_constant) uniform Push { uint shift; uint serial_rows; uint serial_bits; };

const uint RADIX = 1u << DIGIT_BITS;
const uint UNITS = SERIAL ? WORKGROUP : WORKGROUP / SUBGROUP;
// Keys and values that an invocation holds in registers: it loads all of them before it needs the first.
const uint HELD = SERIAL ? 1 : ROWS;
uint held_keys[HELD], held_values[HELD];
// Counters of each unit; if STAGED, they are reused for the block's words, which need no more space than counters of 8 bits.
const uint COUNTERS = UNITS * (STAGED ? 256 : RADIX);
shared uint counters[COUNTERS];
shared uint totals[RADIX];
shared uint starts[RADIX]; // destination of the block's keys of each digit

uint rows() { return SERIAL ? serial_rows : ROWS; }

uint radix() { return SERIAL ? 1u << serial_bits : RADIX; }

uint block_size() { return WORKGROUP * rows(); }

uint digit_of(uint key) { return (key >> shift) & (radix() - 1); }

uint unit() { return SERIAL ? gl_LocalInvocationID.x : gl_SubgroupID; }

// Position of this invocation's key in a row.
uint position(uint row) {
    uint start = group_index() * block_size();
    return SERIAL ? start + gl_LocalInvocationID.x * rows() + row
                  : start + (gl_SubgroupID * ROWS + row) * SUBGROUP + gl_SubgroupInvocationID;
}

void clear_counters(uint count) {
    for (uint i = gl_LocalInvocationID.x; i < count; i += WORKGROUP) counters[i] = 0;
    barrier();
}

void hold_keys(uint n) {
    for (uint row = 0; row < HELD; row++) held_keys[row] = position(row) < n ? keys_in[position(row)] : 0;
}

void hold_values(uint n) {
    for (uint row = 0; row < HELD; row++) held_values[row] = position(row) < n ? values_in[position(row)] : 0;
}

// The lanes of this subgroup with the same digit, including this one. Lanes without a key are excluded.
uvec4 peers(uint digit, bool there) {
    uvec4 same = subgroupBallot(there);
    for (uint bit = 0; bit < DIGIT_BITS; bit++) {
        bool set = ((digit >> bit) & 1) != 0;
        uvec4 vote = subgroupBallot(set);
        same &= set ? vote : ~vote;
    }
    return same;
}

// The number of earlier keys with this digit in this subgroup.
uint rank(uint digit, bool there) {
    uint slot = unit() * RADIX + digit;
    uvec4 same = peers(digit, there);
    uint before = subgroupBallotExclusiveBitCount(same);
    uint seen = there ? counters[slot] : 0;
    subgroupBarrier();
    if (there && before == 0) counters[slot] = seen + subgroupBallotBitCount(same);
    subgroupBarrier();
    return seen + before;
}

// Counts the keys of an invocation's run by digit.
void count_run(uint n) {
    [[dont_unroll]] for (uint row = 0; row < rows(); row++) {
        if (position(row) < n) counters[unit() * radix() + digit_of(keys_in[position(row)])]++;
    }
}

void count_digits(uint n) {
    if (!SERIAL) hold_keys(n);
    clear_counters(SERIAL ? UNITS * radix() : radix());
    if (SERIAL) {
        count_run(n);
    } else {
        for (uint row = 0; row < ROWS; row++) {
            // Sums of integers do not depend on the order.
            if (position(row) < n) atomicAdd(counters[digit_of(held_keys[row])], 1);
        }
    }
    barrier();
    uint blocks = (n + block_size() - 1) / block_size();
    if (group_index() >= blocks) return;
    for (uint digit = gl_LocalInvocationID.x; digit < radix(); digit += WORKGROUP) {
        uint sum = 0;
        [[dont_unroll]] for (uint u = 0; u < (SERIAL ? UNITS : 1); u++) sum += counters[u * radix() + digit];
        digits[FEW_BLOCKS ? group_index() * radix() + digit : digit * blocks + group_index()] = sum;
    }
}

void scan_digits(uint n) {
    uint digit = group_index() * UNITS + unit();
    if (digit >= radix()) return;
    uint blocks = (n + block_size() - 1) / block_size();
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
    if (SERIAL || subgroupElect()) digits[radix() * blocks + digit] = sum;
}

// The number of keys of each digit, and in `starts` the number of those in previous blocks.
void count_before(uint blocks) {
    for (uint digit = gl_LocalInvocationID.x; digit < radix(); digit += WORKGROUP) {
        uint total = 0, before = 0;
        if (FEW_BLOCKS) {
            // As with keys: several are loaded before the first is needed.
            for (uint first = 0; first < blocks; first += 8) {
                uint own[8];
                [[unroll]] for (uint k = 0; k < 8; k++) own[k] = first + k < blocks ? digits[(first + k) * radix() + digit] : 0;
                [[unroll]] for (uint k = 0; k < 8; k++) {
                    total += own[k];
                    before += first + k < group_index() ? own[k] : 0;
                }
            }
        } else {
            total = digits[radix() * blocks + digit];
            before = group_index() < blocks ? digits[digit * blocks + group_index()] : 0;
        }
        totals[digit] = total;
        starts[digit] = before;
    }
    barrier();
}

// One subgroup turns the digits' totals into the numbers of keys with smaller digits.
void scan_totals() {
    if (gl_SubgroupID != 0) return;
    uint carry = 0;
    for (uint first = 0; first < radix(); first += SUBGROUP) {
        uint digit = first + gl_SubgroupInvocationID;
        uint own = digit < radix() ? totals[digit] : 0;
        uint inclusive = subgroupInclusiveAdd(own);
        if (digit < radix()) totals[digit] = carry + inclusive - own;
        carry += subgroupBroadcast(inclusive, SUBGROUP - 1);
    }
}

// Turns the counters of a digit into sums over the units before each, starting at `start`; returns the sum of all.
uint scan_units(uint digit, uint start) {
    for (uint u = 0; u < UNITS; u++) {
        uint own = counters[u * radix() + digit];
        counters[u * radix() + digit] = start;
        start += own;
    }
    return start;
}

// Writes the keys and values of an invocation's run in their order: the counter of a digit is the position of its next key.
void write_run(uint n) {
    [[dont_unroll]] for (uint row = 0; row < rows(); row++) {
        uint at = position(row);
        if (at < n) {
            uint own = keys_in[at], to = counters[unit() * radix() + digit_of(own)]++;
            keys_out[to] = own;
            values_out[to] = values_in[at];
        }
    }
}

// Writes keys and values at the positions given by their ranks.
void write_by_rank(uint n, uint ranks[HELD]) {
    for (uint row = 0; row < HELD; row++) {
        if (position(row) < n) {
            uint to = counters[unit() * radix() + digit_of(held_keys[row])] + ranks[row];
            keys_out[to] = held_keys[row];
            values_out[to] = held_values[row];
        }
    }
}

// The same through shared memory, where the block's words are put in order.
void write_staged(uint n, uint ranks[HELD]) {
    for (uint digit = gl_LocalInvocationID.x; digit < radix(); digit += WORKGROUP) totals[digit] = scan_units(digit, 0);
    barrier();
    scan_totals();
    barrier();
    uint places[HELD], targets[HELD];
    for (uint row = 0; row < HELD; row++) {
        uint digit = digit_of(held_keys[row]);
        places[row] = totals[digit] + counters[unit() * radix() + digit] + ranks[row];
    }
    barrier();
    for (uint row = 0; row < HELD; row++) {
        if (position(row) < n) counters[places[row]] = held_keys[row];
    }
    barrier();
    uint here = min(block_size(), n - group_index() * block_size());
    for (uint row = 0; row < HELD; row++) {
        uint place = row * WORKGROUP + gl_LocalInvocationID.x;
        if (place < here) {
            uint own = counters[place], digit = digit_of(own);
            targets[row] = starts[digit] + place - totals[digit];
            keys_out[targets[row]] = own;
        }
    }
    barrier();
    for (uint row = 0; row < HELD; row++) {
        if (position(row) < n) counters[places[row]] = held_values[row];
    }
    barrier();
    for (uint row = 0; row < HELD; row++) {
        uint place = row * WORKGROUP + gl_LocalInvocationID.x;
        if (place < here) values_out[targets[row]] = counters[place];
    }
}

void scatter(uint n) {
    uint ranks[HELD];
    if (!SERIAL) {
        hold_keys(n);
        hold_values(n);
    }
    uint blocks = (n + block_size() - 1) / block_size();
    count_before(blocks);
    scan_totals();
    clear_counters(UNITS * radix());
    for (uint digit = gl_LocalInvocationID.x; digit < radix(); digit += WORKGROUP) starts[digit] += totals[digit];
    if (SERIAL) {
        count_run(n);
    } else {
        for (uint row = 0; row < HELD; row++) ranks[row] = rank(digit_of(held_keys[row]), position(row) < n);
    }
    barrier();
    if (group_index() >= blocks) return;
    if (STAGED) {
        write_staged(n, ranks);
        return;
    }
    for (uint digit = gl_LocalInvocationID.x; digit < radix(); digit += WORKGROUP) scan_units(digit, starts[digit]);
    barrier();
    if (SERIAL) write_run(n);
    else write_by_rank(n, ranks);
}

void main() {
    uint n = count[0];
    if (PHASE == COUNT_DIGITS) count_digits(n);
    else if (PHASE == SCAN_DIGITS) scan_digits(n);
    else scatter(n);
}
