// SSIM of a picture x and a photo y, under a window that is the product of its samples along both axes.
//
// With m = E[x], r = E[(x - y)^2], c = E[xy] under the window and n = E[y], SSIM's map is s = AB / ED of
//   A = 2 m n + C1, E = A + (m - n)^2, B = 2 (c - m n) + C2, D = B + r - (m - n)^2,
// which equals the usual quotient. For nearly equal pictures 1 - s is not a difference of large numbers here, so that
// it and its slopes are exact near the end of training.
//   d(sum s)/dx = W(ds/dm) + 2 (x - y) W(ds/dr) + y W(ds/dc), where W is the same, symmetric window.

/// Samples of the window along an axis.
const uint TAPS = 11;
/// Radius of the window in pixels.
const uint RADIUS = 5;
/// Keeps SSIM's luminance term finite: (0.01 x range 1)^2.
const float C1 = 1e-4;
/// Keeps SSIM's contrast term finite: (0.03 x range 1)^2.
const float C2 = 9e-4;

// Gaussian of sigma 1.5 over 11 samples, normalised.
const float WINDOW[TAPS] = float[](0.0010283801, 0.0075987581, 0.0360007721, 0.1093606895, 0.2130055377, 0.2660117249,
                                   0.2130055377, 0.1093606895, 0.0360007721, 0.0075987581, 0.0010283801);

// SSIM's map at a pixel, and its partial derivatives.
struct Ssim {
    float map;
    float by_m;
    float by_r;
    float by_c;
};

Ssim ssim_of(float m, float n, float r, float c) {
    float apart = m - n;
    float a = 2 * m * n + C1, e = a + apart * apart;
    float b = 2 * (c - m * n) + C2, excess = r - apart * apart, d = b + excess;
    float share = 1 / (e * d), map = a * b * share;
    float missing = (a * excess + apart * apart * d) * share; // 1 - map
    Ssim s;
    s.map = map;
    s.by_m = 2 * share * ((b - a) * (n * missing - apart * map) - m * map * (excess - apart * apart));
    s.by_r = -map / d;
    s.by_c = 2 * a * excess * share / d;
    return s;
}
