//! A model in training, with everything that is stored per Gaussian.

use super::moments::{self, Moments};
use crate::gaussians::resident::Resident;
use crate::gaussians::{Attributes, Gaussians};
use crate::gpu::{Buffer, Device, Recording, Result};

/// A model in training, which density control replaces and a checkpoint stores.
pub struct Trainee {
    /// The model.
    pub model: Resident,
    /// Moments of Adam.
    pub moments: Moments,
    /// n x (sum of the norms of the gradients by the 2D mean, in NDC units; number of views that saw it), which density
    /// control reads.
    pub growth: Buffer<[f32; 2]>,
}

impl Trainee {
    /// Bytes of a model of `n` Gaussians in training.
    pub fn bytes(n: usize, degree: usize) -> u64 {
        let of = Buffer::<[f32; 2]>::bytes_of;
        Resident::bytes(n, degree) + Attributes::widths(degree).map(|width| of(n * width)).sum() + of(n)
    }

    /// Arrays for `n` Gaussians of this SH degree, whose content is undefined.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn room(device: &Device, n: usize, degree: usize) -> Result<Self> {
        let sizes = Attributes::NAMES.zip(Attributes::widths(degree).map(|width| n * width));
        let parameters = sizes.try_map(|(name, len)| device.buffer(name, len))?;
        let moments = sizes.try_map(|(name, len)| device.buffer(&format!("{name}.moments"), len))?;
        let model = Resident::new(device, parameters, degree, n)?;
        Ok(Self { model, moments, growth: device.buffer("growth", n)? })
    }

    /// A model before its first iteration: moments and growth are zero.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn new(device: &Device, model: &Gaussians) -> Result<Self> {
        let model = Resident::upload(device, model)?;
        let moments = moments::zeros(device, &model)?;
        let growth = device.upload("growth", &vec![[0.0; 2]; model.len])?;
        Ok(Self { model, moments, growth })
    }

    /// Adds an SH band of zeros to the model.
    ///
    /// # Errors
    /// Device memory; device errors. The model is then unchanged.
    pub fn raise_degree(&mut self, device: &Device) -> Result<()> {
        let l = self.model.degree + 1;
        let (name, len) = (Attributes::NAMES.sh[l], self.model.len * Gaussians::band_width(l));
        let (band, moments) = (device.buffer(name, len)?, device.buffer(&format!("{name}.moments"), len)?);
        let mut recording = Recording::new();
        recording.fill(&band, 0);
        recording.fill(&moments, 0);
        device.run(recording)?;
        self.model.parameters.sh[l] = band;
        self.moments.sh[l] = moments;
        self.model.degree = l;
        Ok(())
    }
}
