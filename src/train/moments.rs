//! Adam's moments in device memory.

use crate::gaussians::Attributes;
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Recording, Result};

/// First and second moments of every parameter, laid out as the parameters are.
pub type Moments = Attributes<Buffer<[f32; 2]>>;

/// Moments of zero for a model.
pub fn zeros(device: &Device, model: &Resident) -> Result<Moments> {
    zeros_of(device, model.len, model.degree)
}

/// Zero moments for `n` Gaussians of this SH degree, as [`zeros`].
pub(super) fn zeros_of(device: &Device, n: usize, degree: usize) -> Result<Moments> {
    let mut recording = Recording::new();
    let moments = Attributes::NAMES.zip(Attributes::widths(degree)).try_map(|(name, width)| {
        let buffer = device.buffer(&format!("{name}.moments"), n * width)?;
        recording.fill(&buffer, 0);
        Ok(buffer)
    })?;
    device.run(recording)?;
    Ok(moments)
}
