//! The loss, value and gradient, against the float64 twin.

use super::Allowed::Rounding;
use super::Measure;
use super::overlap::worse;
use crate::gpu::{Device, Recording, Result};
use crate::random::Random;
use crate::reference;
use crate::response::Target;
use crate::scene::AlphaRole;
use crate::train::loss::{Loss, Weights};

/// A picture, its photo, and the terms of their loss; by default L1 and SSIM of an opaque photo.
#[derive(Clone, Debug, Default)]
pub struct Case {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// The picture, row by row.
    pub image: Vec<[f32; 4]>,
    /// The photo, row by row.
    pub photo: Vec<[u8; 4]>,
    /// Meaning of the photo's fourth byte.
    pub alpha_role: AlphaRole,
    /// Colour behind the photo.
    pub background: [f32; 3],
    /// Weights of the loss's terms.
    pub weights: Weights,
}

impl Case {
    /// A picture and a photo of one value each.
    pub fn flat(size: [u32; 2], x: f32, y: u8) -> Self {
        let count = (size[0] * size[1]) as usize;
        Self { size, image: vec![[x; 4]; count], photo: vec![[y; 4]; count], ..Self::default() }
    }

    /// Random values; the picture's are below `brightest`.
    pub fn noise(size: [u32; 2], brightest: f64, seed: u64) -> Self {
        let mut r = Random(seed);
        let count = size[0] * size[1];
        let image = (0..count).map(|_| [0; 4].map(|_| r.within(0.0, brightest) as f32)).collect();
        let photo = (0..count).map(|_| [0; 4].map(|_| r.within(0.0, 256.0) as u8)).collect();
        Self { size, image, photo, ..Self::default() }
    }

    /// The twin's value and gradient.
    pub fn expected(&self) -> (f64, Vec<[f64; 3]>) {
        let x: Vec<[f64; 3]> = self.image.iter().map(|p| [p[0], p[1], p[2]].map(f64::from)).collect();
        let over = |p: &[u8; 4]| -> [f64; 3] {
            let opacity = if self.alpha_role.shows_background() { f64::from(p[3]) / 255.0 } else { 1.0 };
            std::array::from_fn(|c| f64::from(p[c]) / 255.0 * opacity + f64::from(self.background[c]) * (1.0 - opacity))
        };
        let y: Vec<[f64; 3]> = self.photo.iter().map(over).collect();
        let similar = reference::loss::loss(&x, &y, self.size[0] as usize, 1.0);
        let [l1, ssim, l2] = [self.weights.l1, self.weights.ssim, self.weights.l2].map(f64::from);
        let share = 1.0 / (3 * x.len()) as f64;
        let pairs = x.as_flattened().iter().zip(y.as_flattened());
        let squares: f64 = pairs.map(|(x, y)| (x - y).powi(2) * share).sum();
        let slope = |p: usize, c: usize| {
            let difference = x[p][c] - y[p][c];
            // The slope of L1 is zero at equality, where signum would give one.
            let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
            share * (l1 * sign + 2.0 * l2 * difference) + ssim * similar.gradient[p][c]
        };
        let gradient = (0..x.len()).map(|p| std::array::from_fn(|c| slope(p, c))).collect();
        (l1 * similar.l1 + ssim * similar.value + l2 * squares, gradient)
    }

    /// The device's value and gradient; `loss` has room for the picture.
    pub fn computed(&self, device: &Device, loss: &Loss) -> Result<(f32, Vec<[f32; 4]>)> {
        let image = device.upload("image", &self.image)?;
        let words: Vec<u32> = self.photo.iter().map(|p| u32::from_le_bytes(*p)).collect();
        let photo = device.upload("photo", &words)?;
        let Self { size, alpha_role, background, weights, .. } = *self;
        let mut recording = Recording::new();
        loss.record(&mut recording, &image, Target { photo: &photo, size, alpha_role, background }, weights);
        loss.record_value(&mut recording, size);
        device.run(recording)?;
        Ok((loss.value(device, size, weights)?, loss.gradient.read_first(device, self.image.len())?))
    }

    /// Errors of value and gradient, relative to the twin's; the gradient's norm counts as at least a tenth of an L1
    /// gradient's, so that rounding at the optimum, where the gradient vanishes, is not divided by zero. No term
    /// depends on alpha: a slope by it is an infinite error.
    pub fn errors(&self, device: &Device, loss: &Loss) -> Result<[f64; 2]> {
        let (value, gradient) = self.computed(device, loss)?;
        let (right, slopes) = self.expected();
        let pairs = || gradient.iter().zip(&slopes).flat_map(|(g, s)| (0..3).map(|c| (f64::from(g[c]), s[c])));
        let off: f64 = pairs().map(|(g, s)| (g - s).powi(2)).sum();
        let norm: f64 = pairs().map(|(_, s)| s * s).sum();
        let least = 0.1 / ((3 * slopes.len()) as f64).sqrt();
        let by_alpha = if gradient.iter().all(|g| g[3] == 0.0) { 0.0 } else { f64::INFINITY };
        let of_value = (f64::from(value) - right).abs() / right.abs().max(0.01);
        Ok([of_value, off.sqrt() / norm.sqrt().max(least) + by_alpha])
    }
}

/// Float32's window sums are off by 1e-7 of their terms, and covariances computed from them are divided by C2 = 9e-4:
/// an error of 1e-4 times the squared brightness in SSIM, and therefore in value and gradient.
fn worst(device: &Device, cases: impl IntoIterator<Item = Case>, allowed: [f64; 2]) -> Result<Vec<Measure>> {
    let (mut value, mut gradient) = (0.0, 0.0);
    for case in cases {
        let loss = Loss::new(device, case.size[0], case.size[1])?;
        let [v, g] = case.errors(device, &loss)?;
        value = worse(value, v);
        gradient = worse(gradient, g);
    }
    Ok(vec![("value", value, Rounding(allowed[0])), ("gradient", gradient, Rounding(allowed[1]))])
}

pub(super) fn noise(device: &Device) -> Result<Vec<Measure>> {
    let sizes = [[1, 1], [11, 7], [11, 11], [45, 37], [3, 40], [40, 3]];
    worst(device, sizes.map(|size| Case::noise(size, 1.2, u64::from(size[0] * 64 + size[1]))), [1e-5, 1e-4])
}

/// Window sums of equal values differ only by their own rounding, and one shade is 3: errors of 9e-5 and 1.5e-4; with
/// quotients off by two roundings, 9e-5 and 2.1e-4.
pub(super) fn constant(device: &Device) -> Result<Vec<Measure>> {
    let shades = [(0.0, 0), (1.0, 255), (0.0, 255), (1.0, 0), (0.5, 128), (0.25, 192), (3.0, 255)];
    let cases = [[1, 1], [11, 11], [11, 3], [3, 40], [45, 37]]
        .into_iter()
        .flat_map(|size| shades.map(|(x, y)| Case::flat(size, x, y)));
    worst(device, cases, [2e-4, 4e-4])
}

/// Half of the values are 0 or 1, as in a photo of a lamp at night.
pub(super) fn saturated(device: &Device) -> Result<Vec<Measure>> {
    let mut case = Case::noise([45, 37], 2.0, 9);
    case.image.iter_mut().for_each(|p| *p = p.map(|v| (v - 0.5).clamp(0.0, 1.0)));
    let extreme = |v: u8| if v > 190 { 255 } else { v.saturating_sub(64) };
    case.photo.iter_mut().for_each(|p| *p = p.map(extreme));
    worst(device, [case], [1e-5, 1e-4])
}
