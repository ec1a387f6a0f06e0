//! The model in device memory.

use super::{Attributes, Gaussians, MAX_SH_DEGREE};
use crate::gpu::{Buffer, Device, Result};
use crate::primitives::{Count, Scan};
use half::f16;

/// A model in device memory: the stored parameters, one buffer per attribute, SH one per band.
pub struct Resident {
    /// Number of Gaussians, on the device.
    pub count: Count,
    /// n x width numbers each; a band that the model lacks is empty, and no kernel reads it.
    pub parameters: Attributes<Buffer<f32>>,
    /// Number of bands that have arrays, minus one.
    pub degree: usize,
    /// True if SH coefficients are halves, two per word. Such a model can be rendered, but not trained.
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

    /// Uploads a model without its colours. Its overlaps can be computed; it cannot be rendered.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn upload_shapes(device: &Device, model: &Gaussians) -> Result<Self> {
        let mut arrays = model.attributes();
        arrays.sh = [&[]; MAX_SH_DEGREE + 1];
        let parameters = Attributes::NAMES.zip(arrays).try_map(|(name, values)| device.upload(name, values))?;
        Self::new(device, parameters, 0, model.len())
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

    /// Uploads a model with SH coefficients rounded to halves, two per word, which halves the largest part of a model.
    /// It can be rendered, but neither trained nor downloaded.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn upload_half(device: &Device, model: &Gaussians) -> Result<Self> {
        let mut resident = Self::upload_shapes(device, model)?;
        let degree = model.degree().min(MAX_SH_DEGREE);
        for (l, band) in model.sh.iter().enumerate().take(degree + 1) {
            resident.parameters.sh[l] = device.upload(Attributes::NAMES.sh[l], &halves(band))?.cast();
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

/// Halves of floats, each the nearest, ties to even; two per word, the first in the lower bits.
fn halves(values: &[f32]) -> Vec<u32> {
    let bits = |v: f32| u32::from(f16::from_f32(v).to_bits());
    values.chunks(2).map(|pair| bits(pair[0]) | pair.get(1).map_or(0, |v| bits(*v)) << 16).collect()
}

#[cfg(test)]
mod tests {
    use super::halves;

    #[test]
    fn halves_lie_two_a_word() {
        assert_eq!(halves(&[1.0, -2.0, 0.1]), [0xc000_3c00, 0x2e66]);
        // A tie goes to the even half; what is beyond the largest is infinite; what is below the least is zero.
        assert_eq!(halves(&[1.0 + 2.0_f32.powi(-11), 65520.0, 2.0_f32.powi(-25), -0.0]), [0x7c00_3c00, 0x8000_0000]);
        assert!(halves(&[]).is_empty());
    }
}
