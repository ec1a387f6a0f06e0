//! The gradient of L = sum C (C - blur C) by the picture C, the bracket held constant.

/// Half the window's width, in pixels.
const RADIUS: i64 = 6;
/// Twice the variance of the blur's Gaussian (sigma = 2), square pixels.
const TWICE_VARIANCE: f64 = 8.0;

/// C - blur C by colour; the fourth component is the mean of its absolute value over the colours. `image` holds RGB and
/// alpha of `width` x `height` pixels, row by row; the blur's weights are renormalised at the border.
///
/// # Panics
/// If `image` does not have `width` x `height` pixels.
pub fn high_pass(image: &[[f64; 4]], [width, height]: [u32; 2]) -> Vec<[f64; 4]> {
    let (w, h) = (i64::from(width), i64::from(height));
    assert_eq!(image.len() as i64, w * h, "pixels of {width} x {height}");
    let weight = |d: i64| (-(d * d) as f64 / TWICE_VARIANCE).exp();
    let pixel = |x: i64, y: i64| {
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for v in (y - RADIUS).max(0)..=(y + RADIUS).min(h - 1) {
            for u in (x - RADIUS).max(0)..=(x + RADIUS).min(w - 1) {
                let k = weight(u - x) * weight(v - y);
                (0..3).for_each(|c| sum[c] += k * image[(v * w + u) as usize][c]);
                total += k;
            }
        }
        let d: [f64; 3] = std::array::from_fn(|c| image[(y * w + x) as usize][c] - sum[c] / total);
        [d[0], d[1], d[2], d.iter().map(|v| v.abs()).sum::<f64>() / 3.0]
    };
    (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| pixel(x, y)).collect()
}
