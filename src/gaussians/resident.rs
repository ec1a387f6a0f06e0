//! The model in device memory.

use super::{Gaussians, MAX_SH_DEGREE};
use crate::gpu::{Buffer, Device, Result};
use crate::primitives::{Count, Scan};

/// A model in device memory: the stored parameters, one buffer per attribute, SH one per band.
pub struct Resident {
    /// Number of Gaussians, on the device.
    pub count: Count,
    /// n x 3.
    pub means: Buffer<f32>,
    /// n x 3.
    pub log_scales: Buffer<f32>,
    /// n quaternions (w, x, y, z).
    pub rotations: Buffer<[f32; 4]>,
    /// n.
    pub opacity_logits: Buffer<f32>,
    /// Band l: n x (2l + 1) x 3; a band that the model lacks is one word that no kernel reads.
    pub sh: [Buffer<f32>; MAX_SH_DEGREE + 1],
    /// Bands that have arrays, less one.
    pub degree: usize,
    /// Whether SH coefficients are halves, two a word: to be drawn, not to be trained.
    pub half: bool,
    /// Gaussians as uploaded.
    pub len: usize,
}

impl Resident {
    /// Bytes of a model of `n` Gaussians on the device.
    pub fn bytes(n: usize, degree: usize) -> u64 {
        let band = |l: usize| Buffer::<f32>::bytes_of(if l <= degree { n * Gaussians::band_width(l) } else { 1 });
        let bands: u64 = (0..=MAX_SH_DEGREE).map(band).sum();
        let main = 2 * Buffer::<f32>::bytes_of(3 * n) + Buffer::<[f32; 4]>::bytes_of(n) + Buffer::<f32>::bytes_of(n);
        Count::bytes() + main + bands
    }

    /// Uploads a model.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn upload(device: &Device, model: &Gaussians) -> Result<Self> {
        let n = model.len();
        let degree = model.degree().min(MAX_SH_DEGREE);
        let band = |l: usize| match model.sh.get(l) {
            Some(values) => device.upload(["sh0", "sh1", "sh2", "sh3"][l], values),
            None => device.upload("absent band", &[0.0]),
        };
        Ok(Self {
            count: Count::known(device, "Gaussians", n as u32, &[Scan::block(device)])?,
            means: device.upload("means", model.means.as_flattened())?,
            log_scales: device.upload("log scales", model.log_scales.as_flattened())?,
            rotations: device.upload("rotations", &model.rotations)?,
            opacity_logits: device.upload("opacity logits", &model.opacity_logits)?,
            sh: [band(0)?, band(1)?, band(2)?, band(3)?],
            degree,
            half: false,
            len: n,
        })
    }

    /// Bytes of a model of `n` Gaussians whose SH coefficients are halves.
    pub fn half_bytes(n: usize, degree: usize) -> u64 {
        let bands = |halve: bool| -> u64 {
            let words = |l: usize| (n * Gaussians::band_width(l)).div_ceil(if halve { 2 } else { 1 });
            (0..=degree.min(MAX_SH_DEGREE)).map(|l| Buffer::<f32>::bytes_of(words(l))).sum()
        };
        Self::bytes(n, degree) - bands(false) + bands(true)
    }

    /// Uploads a model with its SH coefficients rounded to halves, two a word: half of what most of a model takes. It can be
    /// drawn, but neither trained nor downloaded.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn upload_half(device: &Device, model: &Gaussians) -> Result<Self> {
        let mut resident = Self::upload(device, &Gaussians { sh: vec![vec![0.0; 3 * model.len()]], ..model.clone() })?;
        let degree = model.degree().min(MAX_SH_DEGREE);
        for (l, band) in model.sh.iter().enumerate().take(degree + 1) {
            let word = |pair: &[f32]| {
                let high = pair.get(1).map_or(0, |v| u32::from(half(*v)));
                high << 16 | u32::from(half(pair[0]))
            };
            let words: Vec<u32> = band.chunks(2).map(word).collect();
            resident.sh[l] = device.upload(["half sh0", "half sh1", "half sh2", "half sh3"][l], &words)?.cast();
        }
        (resident.degree, resident.half) = (degree, true);
        Ok(resident)
    }

    /// Downloads the model.
    ///
    /// # Errors
    /// Device errors.
    pub fn download(&self, device: &Device) -> Result<Gaussians> {
        let rows3 = |v: Vec<f32>| v.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        Ok(Gaussians {
            means: rows3(self.means.read(device)?),
            log_scales: rows3(self.log_scales.read(device)?),
            rotations: self.rotations.read(device)?,
            opacity_logits: self.opacity_logits.read(device)?,
            sh: self.sh[..=self.degree].iter().map(|band| band.read(device)).collect::<Result<_>>()?,
        })
    }
}

/// The nearest half of a float, ties to even, as its bits; beyond the largest it is infinite.
fn half(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = ((bits >> 16) & 0x8000) as u16;
    let size = bits & 0x7fff_ffff;
    if size >= 0x7f80_0000 {
        return sign | if size > 0x7f80_0000 { 0x7e00 } else { 0x7c00 };
    }
    // Below 2^-14 halves are multiples of 2^-24, which float32 rounds to when 0.5 is added and taken off again.
    if size < 0x3880_0000 {
        return sign | (f32::from_bits(size) + 0.5).to_bits().wrapping_sub(0.5_f32.to_bits()) as u16;
    }
    let rounded = size + 0xfff + ((size >> 13) & 1);
    sign | ((rounded - 0x3800_0000) >> 13).min(0x7c00) as u16
}

#[cfg(test)]
mod tests {
    use super::half;

    #[test]
    fn halves_are_the_nearest() {
        let cases = [
            (0.0, 0),
            (-0.0, 0x8000),
            (1.0, 0x3c00),
            (-2.0, 0xc000),
            (65504.0, 0x7bff),
            (65520.0, 0x7c00),
            (1e9, 0x7c00),
            (f32::INFINITY, 0x7c00),
            (2.0_f32.powi(-14), 0x0400),
            (2.0_f32.powi(-24), 0x0001),
            (2.0_f32.powi(-25), 0x0000),
            (3.0 * 2.0_f32.powi(-25), 0x0002),
            (1.0 + 2.0_f32.powi(-11), 0x3c00),
            (1.0 + 3.0 * 2.0_f32.powi(-11), 0x3c02),
            (0.1, 0x2e66),
        ];
        for (value, bits) in cases {
            assert_eq!(half(value), bits, "{value}");
        }
        assert_eq!(half(f32::NAN) & 0x7e00, 0x7e00);
    }
}
