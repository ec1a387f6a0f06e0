// Random numbers by key, without state: a resumed run draws the same ones.
uint hash(uint x) { // PCG's output permutation (O'Neill 2014) over one linear congruential step
    x = x * 747796405u + 2891336453u;
    x = ((x >> ((x >> 28) + 4)) ^ x) * 277803737u;
    return (x >> 22) ^ x;
}

// Two independent standard normals (Box and Muller). The angle is shifted by half a turn: Vulkan guarantees the
// precision of sine and cosine within [-pi, pi] only.
vec2 normals(uvec4 key) {
    uint h = hash(key.x ^ hash(key.y ^ hash(key.z ^ hash(key.w))));
    float u = (float(h >> 8) + 1) / 16777217.0;
    float angle = 6.283185307179586 * (float(hash(h) >> 8) / 16777216.0 - 0.5);
    // A coarse logarithm of 1 may be positive.
    return -sqrt(max(0.0, -2 * log(u))) * vec2(cos(angle), sin(angle));
}
