//! L1 + SSIM, value and gradient, against the float64 twin.

use super::Allowed::Rounding;
use super::Measure;
use super::overlap::worse;
use crate::gpu::{Device, Recording, Result};
use crate::random::Random;
use crate::reference;
use crate::response::Target;
use crate::scene::AlphaRole;
use crate::train::loss::{Loss, Weights};

struct Case {
    width: u32,
    height: u32,
    image: Vec<[f32; 4]>,
    photo: Vec<[u8; 4]>,
}

impl Case {
    fn flat(width: u32, height: u32, x: f32, y: u8) -> Self {
        let count = (width * height) as usize;
        Self { width, height, image: vec![[x; 4]; count], photo: vec![[y; 4]; count] }
    }

    fn noise(width: u32, height: u32, brightest: f64, seed: u64) -> Self {
        let mut r = Random(seed);
        let count = width * height;
        let image = (0..count).map(|_| [0; 4].map(|_| r.within(0.0, brightest) as f32)).collect();
        Self { width, height, image, photo: (0..count).map(|_| [0; 4].map(|_| r.within(0.0, 256.0) as u8)).collect() }
    }

    /// Errors of value and gradient, relative to the twin's; the gradient's norm counts as at least a tenth of an L1
    /// gradient's, so that rounding at the optimum, where the gradient vanishes, is not divided by zero.
    fn errors(&self, device: &Device) -> Result<[f64; 2]> {
        let image = device.upload("image", &self.image)?;
        let words: Vec<u32> = self.photo.iter().map(|p| u32::from_le_bytes(*p)).collect();
        let photo = device.upload("photo", &words)?;
        let (loss, size, weights) =
            (Loss::new(device, self.width, self.height)?, [self.width, self.height], Weights::default());
        let mut recording = Recording::new();
        let target = Target { photo: &photo, size, alpha_role: AlphaRole::Opaque, background: [0.0; 3] };
        loss.record(&mut recording, &image, target, weights);
        loss.record_value(&mut recording, size);
        device.run(recording)?;
        let value = f64::from(loss.value(device, size, weights)?);
        let gradient = loss.gradient.read_first(device, self.image.len())?;

        let x: Vec<[f64; 3]> = self.image.iter().map(|p| [p[0], p[1], p[2]].map(f64::from)).collect();
        let y: Vec<[f64; 3]> = self.photo.iter().map(|p| [p[0], p[1], p[2]].map(|v| f64::from(v) / 255.0)).collect();
        let right = reference::loss::loss(&x, &y, self.width as usize, f64::from(weights.ssim));
        let pairs = || gradient.iter().zip(&right.gradient).flat_map(|(g, e)| (0..3).map(|c| (f64::from(g[c]), e[c])));
        let off: f64 = pairs().map(|(g, e)| (g - e).powi(2)).sum();
        let norm: f64 = pairs().map(|(_, e)| e * e).sum();
        let least = 0.1 / ((3 * x.len()) as f64).sqrt();
        Ok([(value - right.value).abs() / right.value.max(0.01), off.sqrt() / norm.sqrt().max(least)])
    }
}

/// Float32's window sums are off by 1e-7 of their terms, and covariances computed from them are divided by C2 = 9e-4:
/// an error of 1e-4 times the squared brightness in SSIM, and therefore in value and gradient.
fn worst(device: &Device, cases: impl IntoIterator<Item = Case>, allowed: [f64; 2]) -> Result<Vec<Measure>> {
    let (mut value, mut gradient) = (0.0, 0.0);
    for case in cases {
        let [v, g] = case.errors(device)?;
        value = worse(value, v);
        gradient = worse(gradient, g);
    }
    Ok(vec![("value", value, Rounding(allowed[0])), ("gradient", gradient, Rounding(allowed[1]))])
}

pub(super) fn noise(device: &Device) -> Result<Vec<Measure>> {
    let sizes = [(1, 1), (11, 7), (11, 11), (45, 37), (3, 40), (40, 3)];
    worst(device, sizes.map(|(w, h)| Case::noise(w, h, 1.2, u64::from(w * 64 + h))), [1e-5, 1e-4])
}

/// Window sums of equal values differ only by their own rounding, and one shade is 3: errors of 9e-5 and 1.5e-4; with
/// quotients off by two roundings, 9e-5 and 2.1e-4.
pub(super) fn constant(device: &Device) -> Result<Vec<Measure>> {
    let shades = [(0.0, 0), (1.0, 255), (0.0, 255), (1.0, 0), (0.5, 128), (0.25, 192), (3.0, 255)];
    let cases =
        [(11, 11), (11, 3), (45, 37)].into_iter().flat_map(|(w, h)| shades.map(|(x, y)| Case::flat(w, h, x, y)));
    worst(device, cases, [2e-4, 4e-4])
}

/// Half of the values are 0 or 1, as in a photo of a lamp at night.
pub(super) fn saturated(device: &Device) -> Result<Vec<Measure>> {
    let mut case = Case::noise(45, 37, 2.0, 9);
    case.image.iter_mut().for_each(|p| *p = p.map(|v| (v - 0.5).clamp(0.0, 1.0)));
    let extreme = |v: u8| if v > 190 { 255 } else { v.saturating_sub(64) };
    case.photo.iter_mut().for_each(|p| *p = p.map(extreme));
    worst(device, [case], [1e-5, 1e-4])
}
