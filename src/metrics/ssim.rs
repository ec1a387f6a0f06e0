//! Structural similarity, in float64; `reference::loss` has the formula and its gradient.

use super::{Error, Image};
use crate::kernels::constants::ssim;
pub use crate::kernels::constants::ssim::float64::{C1, C2};
use rayon::prelude::*;

/// Window radius in pixels: 11 x 11.
pub const RADIUS: usize = ssim::RADIUS as usize;
/// Standard deviation of the window in pixels.
pub const SIGMA: f64 = 1.5;

/// The window's weights along one axis; they sum to 1.
pub fn window() -> [f64; 2 * RADIUS + 1] {
    let raw: [f64; 2 * RADIUS + 1] = std::array::from_fn(|k| {
        let d = k as f64 - RADIUS as f64;
        (-d * d / (2.0 * SIGMA * SIGMA)).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| w / sum)
}

/// Mean SSIM over pixels and channels: Gaussian window 11 x 11, sigma 1.5, zeros outside the image; 1 for identical
/// images. Pixels count by the weights of `b`, if it has some; windows see both pictures whole.
///
/// # Errors
/// [`Error::Sizes`] if the sizes differ.
pub fn ssim(a: &Image<'_>, b: &Image<'_>) -> Result<f64, Error> {
    a.same_size(b)?;
    if a.pixels() == b.pixels() {
        return Ok(1.0); // rounding would leave 1 - 1e-17 here
    }
    // Summed per row and then in order, so that the sum does not depend on the threads.
    let rows: Vec<f64> = (0..a.height()).into_par_iter().map_init(Scratch::default, |s, y| row(s, a, b, y)).collect();
    let count = b.weights().map_or(a.pixels().len() as f64, |weights| weights.iter().map(|w| f64::from(*w)).sum());
    Ok(rows.iter().sum::<f64>() / count)
}

/// Window sums down the columns, for one row with a zero border of the window's radius: x, y, xx, yy, xy.
#[derive(Default)]
struct Scratch([Vec<f64>; 5]);

/// Sum of SSIM over row `y`: down the columns and then along the row, all three channels together.
fn row(scratch: &mut Scratch, a: &Image<'_>, b: &Image<'_>, y: usize) -> f64 {
    let (length, border, weights) = (a.width() * 3, RADIUS * 3, window());
    let [ex, ey, exx, eyy, exy] = &mut scratch.0;
    for sums in [&mut *ex, ey, exx, eyy, exy] {
        sums.clear();
        sums.resize(length + 2 * border, 0.0);
    }
    let inner = border..border + length;
    for (k, w) in weights.into_iter().enumerate() {
        let Some(row) = (y + k).checked_sub(RADIUS).filter(|&r| r < a.height()) else { continue };
        let at = row * length..(row + 1) * length;
        let (ex, ey) = (&mut ex[inner.clone()], &mut ey[inner.clone()]);
        let (exx, eyy, exy) = (&mut exx[inner.clone()], &mut eyy[inner.clone()], &mut exy[inner.clone()]);
        let (xs, ys) = (&a.pixels()[at.clone()], &b.pixels()[at]);
        for i in 0..length {
            let (x, y) = (f64::from(xs[i]), f64::from(ys[i]));
            ex[i] += w * x;
            ey[i] += w * y;
            exx[i] += w * x * x;
            eyy[i] += w * y * y;
            exy[i] += w * x * y;
        }
    }
    let along = |sums: &[f64], i: usize| (0..weights.len()).map(|k| weights[k] * sums[i + 3 * k]).sum::<f64>();
    let counts = b.weights().map(|weights| &weights[y * length..(y + 1) * length]);
    (0..length)
        .map(|i| {
            let (ux, uy) = (along(ex, i), along(ey, i));
            let (a1, a2) = (2.0 * ux * uy + C1, 2.0 * (along(exy, i) - ux * uy) + C2);
            let (b1, b2) = (ux * ux + uy * uy + C1, (along(exx, i) - ux * ux) + (along(eyy, i) - uy * uy) + C2);
            a1 * a2 / (b1 * b2) * counts.map_or(1.0, |weights| f64::from(weights[i]))
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::loss::ssim_map;

    /// The twin's SSIM, channel by channel.
    fn twin(a: &Image<'_>, b: &Image<'_>) -> f64 {
        let channel = |i: &Image<'_>, c: usize| i.pixels().iter().skip(c).step_by(3).map(|&v| v.into()).collect();
        let sum: f64 = (0..3)
            .map(|c| {
                let (x, y): (Vec<f64>, Vec<f64>) = (channel(a, c), channel(b, c));
                ssim_map(&x, &y, a.width()).0.iter().sum::<f64>()
            })
            .sum();
        sum / a.pixels().len() as f64
    }

    #[test]
    fn agrees_with_the_twin() {
        for (width, height) in [(1, 1), (11, 3), (11, 11), (3, 40), (37, 29), (64, 1)] {
            let mut seed = 7u32;
            let mut noise = || {
                seed = seed.wrapping_mul(1664525).wrapping_add(1013904223);
                (seed >> 8) as f32 / (1 << 24) as f32
            };
            let count = width * height * 3;
            let (x, y): (Vec<f32>, Vec<f32>) = (0..count).map(|_| (noise(), noise())).unzip();
            let flat = |v: f32| vec![v; count];
            for (p, q) in [(&x, &y), (&x, &flat(1.0)), (&flat(0.0), &flat(1.0)), (&flat(0.5), &flat(0.25)), (&x, &x)] {
                let (a, b) = (Image::new(width, height, p).unwrap(), Image::new(width, height, q).unwrap());
                let (here, there) = (ssim(&a, &b).unwrap(), twin(&a, &b));
                assert!((here - there).abs() < 1e-12, "{width} x {height}: {here}, the twin says {there}");
            }
            let (a, b) = (Image::new(width, height, &x).unwrap(), Image::new(width, height, &y).unwrap());
            assert_eq!(ssim(&a, &a).unwrap(), 1.0);
            let alike = vec![0.5; count];
            let (plain, weighted) = (ssim(&a, &b).unwrap(), ssim(&a, &b.weighted(&alike).unwrap()).unwrap());
            assert!((plain - weighted).abs() < 1e-12, "equal weights change nothing");
        }
    }

    /// Equal pictures down to row 30 of 40, and inverted ones below.
    #[test]
    fn weights_choose_the_pixels_that_count() {
        let (w, h) = (20, 40);
        let x: Vec<f32> = (0..3 * w * h).map(|i| (i * 37 % 101) as f32 / 101.0).collect();
        let y: Vec<f32> = x.iter().enumerate().map(|(i, v)| if i < 90 * w { *v } else { 1.0 - v }).collect();
        let top: Vec<f32> = (0..3 * w * h).map(|i| if i < 60 * w { 1.0 } else { 0.0 }).collect();
        let rest: Vec<f32> = top.iter().map(|w| 1.0 - w).collect();
        let (a, b) = (Image::new(w, h, &x).unwrap(), Image::new(w, h, &y).unwrap());
        assert!((ssim(&a, &b.weighted(&top).unwrap()).unwrap() - 1.0).abs() < 1e-12);
        assert!(ssim(&a, &b.weighted(&rest).unwrap()).unwrap() < 0.9);
    }
}
