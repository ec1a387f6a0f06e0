// The tiles that a splat touches. Counting and emission call the same two functions on the same stored bits.
#include "lib/finite.glsl"
#include "lib/ellipse.glsl"

/// Culling: the ellipse where alpha falls to 1/255, tile by tile.
const uint EXACT = 0;
/// Culling: the square of three standard deviations, as in the 3DGS reference.
const uint THREE_SIGMA = 1;
/// No culling: every splat in every tile.
const uint OFF = 2;

layout(constant_id = 2) const uint TILE = 16; // pixels along a side
layout(constant_id = 3) const uint CULLING = EXACT;

const float THREE_SIGMA_CUT = 4.5 * 1.4426950408889634; // half of 3 squared, in powers of two

struct Footprint {
    vec2 mean;      // pixels from the origin
    vec2 origin;    // whole pixels
    vec2 margin;
    vec3 k;
    float cut;
    vec2 box;       // half extents of the ellipse, pixels
    float turn;     // the ellipse is rightmost at v = -sqrt(cut) turn / hypot(1, turn)
};

Footprint footprint_of(vec2 mean, vec2 origin, vec3 k, float cut) {
    Footprint f;
    f.mean = mean;
    f.origin = origin;
    f.margin = position_margin(mean);
    f.k = k;
    f.cut = (CULLING == THREE_SIGMA ? THREE_SIGMA_CUT : cut) * CUT_MARGIN;
    float root = sqrt(f.cut);
    f.turn = k.y / k.z;
    f.box = vec2(root * sqrt(1 + f.turn * f.turn) / k.x, root / k.z) + f.margin;
    if (CULLING == THREE_SIGMA) {
        // The reference's square: three times the larger standard deviation, rounded up.
        vec2 sigma = f.box / 3;
        float a = sigma.x * sigma.x, c = sigma.y * sigma.y;
        float det = a * c / (1 + f.turn * f.turn);
        float mid = 0.5 * (a + c);
        f.box = vec2(ceil(3 * sqrt(mid + sqrt(max(0.1, mid * mid - det)))));
    }
    return f;
}

// The first and one past the last of `tiles` with pixel centres within [low, high], both relative to `origin`; none if
// one of the two is NaN.
uvec2 tile_span(float low, float high, float origin, uint tiles) {
    // Pixel p has its centre at p + 0.5, so sums are whole numbers and exact. The clamp precedes the conversion to
    // integers, which is undefined for huge floats.
    if (nan(low) || nan(high)) return uvec2(0);
    float most = float(tiles * TILE);
    float first = clamp(ceil(low - 0.5) + origin, 0, most);
    float last = clamp(floor(high - 0.5) + 1 + origin, 0, most);
    if (first >= last) return uvec2(0);
    return uvec2(uint(first) / TILE, (uint(last) + TILE - 1) / TILE);
}

uvec2 tile_rows(Footprint f, uvec2 tiles) {
    if (CULLING == OFF) return uvec2(0, tiles.y);
    return tile_span(f.mean.y - f.box.y, f.mean.y + f.box.y, f.origin.y, tiles.y);
}

// The tiles of one row that the ellipse touches: one span, from the leftmost to the rightmost point of its part between
// the row's first and last pixel centres.
uvec2 tile_columns(Footprint f, uint row, uvec2 tiles) {
    if (CULLING == OFF) return uvec2(0, tiles.x);
    if (CULLING != EXACT) return tile_span(f.mean.x - f.box.x, f.mean.x + f.box.x, f.origin.x, tiles.x);
    float first = float(row * TILE) - f.origin.y;
    float top = first + 0.5 - f.mean.y - f.margin.y;
    float bottom = first + float(TILE) - 0.5 - f.mean.y + f.margin.y;
    vec2 x = f.mean.x + ellipse_columns(f.k, f.cut, f.turn, f.k.z * top, f.k.z * bottom);
    return tile_span(x.x - f.margin.x, x.y + f.margin.x, f.origin.x, tiles.x);
}
