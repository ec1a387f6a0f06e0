//! The training loss 0.8 L1 + 0.2 (1 - SSIM) and its gradient by the rendered image.
//!
//! SSIM per pixel and channel from window means (E, zero outside the image): with ux = E(x), uy = E(y),
//! vx = E(xx) - ux^2, vy = E(yy) - uy^2, vxy = E(xy) - ux uy and
//!   a1 = 2 ux uy + C1,  a2 = 2 vxy + C2,  b1 = ux^2 + uy^2 + C1,  b2 = vx + vy + C2:  s = a1 a2 / (b1 b2).
//! s depends on x through three window means only:
//!   ds/dE(xx) = -s / b2,   ds/dE(xy) = 2 a1 / (b1 b2),
//!   ds/dE(x)  = 2 uy (a2 - a1) / (b1 b2) - 2 ux s (1/b1 - 1/b2),
//! and the window is symmetric, so E is its own transpose: dS/dx = E(ds/dE(x)) + 2 x E(ds/dE(xx)) + y E(ds/dE(xy)).

use crate::metrics::ssim::{C1, C2, RADIUS, window};

/// Weight of 1 - SSIM; L1 gets the rest.
pub const SSIM_WEIGHT: f64 = 0.2;

/// Value and gradient of the loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Loss {
    /// (1 - w) L1 + w (1 - SSIM).
    pub value: f64,
    /// Mean absolute difference over pixels and channels.
    pub l1: f64,
    /// Mean SSIM over pixels and channels.
    pub ssim: f64,
    /// Gradient by the rendered image, pixel by pixel.
    pub gradient: Vec<[f64; 3]>,
}

/// The loss of `rendered` against `truth`, both row by row with `width` pixels per row.
pub fn loss(rendered: &[[f64; 3]], truth: &[[f64; 3]], width: usize, ssim_weight: f64) -> Loss {
    let count = rendered.len();
    let share = 1.0 / (3 * count).max(1) as f64;
    let (mut l1, mut ssim, mut gradient) = (0.0, 0.0, vec![[0.0; 3]; count]);
    for channel in 0..3 {
        let x: Vec<f64> = rendered.iter().map(|p| p[channel]).collect();
        let y: Vec<f64> = truth.iter().map(|p| p[channel]).collect();
        let (map, by_x) = ssim_map(&x, &y, width);
        for p in 0..count {
            let difference = x[p] - y[p];
            // The slope is zero at equality, where signum would give one.
            let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
            l1 += difference.abs() * share;
            ssim += map[p] * share;
            gradient[p][channel] = ((1.0 - ssim_weight) * sign - ssim_weight * by_x[p]) * share;
        }
    }
    Loss { value: (1.0 - ssim_weight) * l1 + ssim_weight * (1.0 - ssim), l1, ssim, gradient }
}

/// One channel's SSIM per pixel, and the gradient of its sum by `x`.
pub fn ssim_map(x: &[f64], y: &[f64], width: usize) -> (Vec<f64>, Vec<f64>) {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>();
    let (ex, ey) = (window_mean(x, width), window_mean(y, width));
    let exx = window_mean(&product(x, x), width);
    let eyy = window_mean(&product(y, y), width);
    let exy = window_mean(&product(x, y), width);

    let mut map = vec![0.0; x.len()];
    let (mut by_ex, mut by_exx, mut by_exy) = (map.clone(), map.clone(), map.clone());
    for p in 0..x.len() {
        let (ux, uy) = (ex[p], ey[p]);
        let (a1, a2) = (2.0 * ux * uy + C1, 2.0 * (exy[p] - ux * uy) + C2);
        let (b1, b2) = (ux * ux + uy * uy + C1, (exx[p] - ux * ux) + (eyy[p] - uy * uy) + C2);
        let s = a1 * a2 / (b1 * b2);
        map[p] = s;
        by_exx[p] = -s / b2;
        by_exy[p] = 2.0 * a1 / (b1 * b2);
        by_ex[p] = 2.0 * uy * (a2 - a1) / (b1 * b2) - 2.0 * ux * s * (1.0 / b1 - 1.0 / b2);
    }
    let (mx, mxx, mxy) = (window_mean(&by_ex, width), window_mean(&by_exx, width), window_mean(&by_exy, width));
    let gradient = (0..x.len()).map(|p| mx[p] + 2.0 * x[p] * mxx[p] + y[p] * mxy[p]).collect();
    (map, gradient)
}

/// Gaussian window mean with zeros outside the image, rows and then columns.
fn window_mean(values: &[f64], width: usize) -> Vec<f64> {
    let height = values.len().checked_div(width).unwrap_or(0);
    let weights = window();
    let along = |from: &[f64], length: usize, stride: usize, at: usize, place: usize| {
        let mut sum = 0.0;
        for (k, w) in weights.into_iter().enumerate() {
            if let Some(q) = (place + k).checked_sub(RADIUS).filter(|&q| q < length) {
                sum += w * from[at + q * stride - place * stride];
            }
        }
        sum
    };
    let rows: Vec<f64> = (0..values.len()).map(|p| along(values, width, 1, p, p % width)).collect();
    (0..values.len()).map(|p| along(&rows, height, width, p, p / width)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Constant, saturated, equal and opposite images, 11 pixels wide and narrower than the window.
    #[test]
    fn flat_images_stay_finite() {
        for (width, height) in [(11, 11), (11, 3), (1, 1), (3, 40)] {
            for (a, b) in [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (0.5, 0.5), (1e6, 0.0)] {
                let (x, y) = (vec![[a; 3]; width * height], vec![[b; 3]; width * height]);
                let l = loss(&x, &y, width, SSIM_WEIGHT);
                assert!(l.value.is_finite() && l.gradient.as_flattened().iter().all(|g| g.is_finite()), "{a} {b}");
                if a == b {
                    assert!((l.ssim - 1.0).abs() < 1e-12 && l.l1 == 0.0, "{a}: SSIM {}", l.ssim);
                    assert!(l.gradient.as_flattened().iter().all(|g| g.abs() < 1e-10), "{a}: a slope at the optimum");
                }
            }
        }
        assert!(loss(&[], &[], 0, SSIM_WEIGHT).value.is_finite());
    }
}
