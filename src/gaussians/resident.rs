//! The model in device memory.

use super::{Attributes, Gaussians, MAX_SH_DEGREE};
use crate::gpu::{Buffer, Device, Result};
use crate::primitives::{Count, Scan};

/// A model in device memory: the stored parameters, one buffer per attribute, SH one per band.
pub struct Resident {
    /// Number of Gaussians, on the device.
    pub count: Count,
    /// n x width numbers each; a band that the model lacks is empty, and no kernel reads it.
    pub parameters: Attributes<Buffer<f32>>,
    /// Bands that have arrays, less one.
    pub degree: usize,
    /// Whether SH coefficients are halves, two per word. Such a model can be rendered, but not trained.
    pub half: bool,
    /// Number of Gaussians.
    pub len: usize,
}

impl Resident {
    /// Bytes of a model of `n` Gaussians on the device.
    pub fn bytes(n: usize, degree: usize) -> u64 {
        Count::bytes() + Attributes::widths(degree).map(|width| Buffer::<f32>::bytes_of(n * width)).sum()
    }

    /// Uploads a model.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn upload(device: &Device, model: &Gaussians) -> Result<Self> {
        let parameters = Attributes::NAMES.zip(model.attributes());
        let parameters = parameters.try_map(|(name, values)| device.upload(name, values))?;
        Self::new(device, parameters, model.degree().min(MAX_SH_DEGREE), model.len())
    }

    /// A model of `n` Gaussians with these arrays.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn new(device: &Device, parameters: Attributes<Buffer<f32>>, degree: usize, n: usize) -> Result<Self> {
        let count = Count::known(device, "Gaussians", n as u32, &[Scan::block(device)])?;
        Ok(Self { count, parameters, degree, half: false, len: n })
    }

    /// The quaternions (w, x, y, z), n.
    pub fn quaternions(&self) -> Buffer<[f32; 4]> {
        self.parameters.rotations.cast()
    }

    /// Bytes of a model of `n` Gaussians whose SH coefficients are halves.
    pub fn half_bytes(n: usize, degree: usize) -> u64 {
        let bands = |halve: bool| -> u64 {
            let words = |l: usize| (n * Gaussians::band_width(l)).div_ceil(if halve { 2 } else { 1 });
            (0..=degree.min(MAX_SH_DEGREE)).map(|l| Buffer::<f32>::bytes_of(words(l))).sum()
        };
        Self::bytes(n, degree) - bands(false) + bands(true)
    }

    /// Uploads a model with SH coefficients rounded to halves, two per word, which halves the largest part of a model. It can
    /// be rendered, but neither trained nor downloaded.
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
            resident.parameters.sh[l] = device.upload(Attributes::NAMES.sh[l], &words)?.cast();
        }
        (resident.degree, resident.half) = (degree, true);
        Ok(resident)
    }

    /// Downloads the model.
    ///
    /// # Errors
    /// Device errors.
    pub fn download(&self, device: &Device) -> Result<Gaussians> {
        let parameters = self.parameters.each_ref().try_map(|values| values.read(device))?;
        Ok(Gaussians::of_attributes(parameters, self.degree + 1))
    }
}

/// Bits of the nearest half of a float, ties to even; infinite beyond the largest half.
fn half(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = ((bits >> 16) & 0x8000) as u16;
    let size = bits & 0x7fff_ffff;
    if size >= 0x7f80_0000 {
        return sign | if size > 0x7f80_0000 { 0x7e00 } else { 0x7c00 };
    }
    // Below 2^-14 halves are multiples of 2^-24, to which float32 rounds when 0.5 is added and subtracted again.
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
