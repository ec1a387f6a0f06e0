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
    /// Number of bands that have arrays, minus one.
    pub degree: usize,
    /// Number of Gaussians.
    pub len: usize,
}

impl Resident {
    /// Bytes of a model of `n` Gaussians on the device.
    pub fn bytes(n: usize, degree: usize) -> u64 {
        Count::bytes() + Attributes::widths(degree).map(|width| Buffer::<f32>::bytes_of(n * width)).sum()
    }

    /// Uploads a model.
    pub fn upload(device: &Device, model: &Gaussians) -> Result<Self> {
        let parameters = Attributes::NAMES.zip(model.attributes());
        let parameters = parameters.try_map(|(name, values)| device.upload(name, values))?;
        Self::new(device, parameters, model.degree().min(MAX_SH_DEGREE), model.len())
    }

    /// Uploads a model without its colours. Its overlaps can be computed; it cannot be rendered.
    pub fn upload_shapes(device: &Device, model: &Gaussians) -> Result<Self> {
        let mut arrays = model.attributes();
        arrays.sh = [&[]; MAX_SH_DEGREE + 1];
        let parameters = Attributes::NAMES.zip(arrays).try_map(|(name, values)| device.upload(name, values))?;
        Self::new(device, parameters, 0, model.len())
    }

    /// A model of `n` Gaussians with these arrays.
    pub fn new(device: &Device, parameters: Attributes<Buffer<f32>>, degree: usize, n: usize) -> Result<Self> {
        let count = Count::known(device, "Gaussians", n as u32, &[Scan::block(device)])?;
        Ok(Self { count, parameters, degree, len: n })
    }

    /// The quaternions (w, x, y, z), n.
    pub fn quaternions(&self) -> Buffer<[f32; 4]> {
        self.parameters.rotations.cast()
    }

    /// Downloads the model.
    pub fn download(&self, device: &Device) -> Result<Gaussians> {
        let parameters = self.parameters.each_ref().try_map(|values| values.read(device))?;
        Ok(Gaussians::of_attributes(parameters, self.degree + 1))
    }
}
