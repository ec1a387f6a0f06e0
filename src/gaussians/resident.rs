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
            len: n,
        })
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
