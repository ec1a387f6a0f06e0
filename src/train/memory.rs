//! Estimate of the device memory that a training run will need.

use super::density;
use super::device_photos::DevicePhotos;
use super::error::Result;
use super::exposure::Exposure;
use super::halve::Halve;
use super::host_check::HostCheck;
use super::loss::Loss;
use super::mask::Mask;
use super::method::Method;
use super::moments;
use super::poses::Poses;
use super::smoothing::Smoothing;
use super::trainer::Trainer;
use super::training_model::{Array, TrainingModel};
use crate::gaussians::Attributes;
use crate::gpu::{Device, LargestBuffer, staging_bytes};
use crate::render::{Purpose, Renderer, Style, Uses};
use std::sync::Arc;

/// Inputs of the memory estimate of a run.
#[derive(Clone, Debug, Default)]
#[expect(clippy::struct_excessive_bools, reason = "facts about a run, each on its own")]
pub struct TrainerNeeds {
    /// Largest number of Gaussians.
    pub gaussians: usize,
    /// Number of further Gaussians that never change.
    pub tail: usize,
    /// Largest number of (tile, Gaussian) pairs of a picture.
    pub pairs: u32,
    /// Largest width and height of a picture.
    pub size: [u32; 2],
    /// Bytes of each photo.
    pub photos: Vec<u64>,
    /// Bytes of the photos' depth maps, if they are trained on.
    pub depths: u64,
    /// Highest SH degree.
    pub degree: usize,
    /// True if each photo has an exposure of its own.
    pub exposure: bool,
    /// True if the photos' cameras are corrected.
    pub poses: bool,
    /// True if photos have masks.
    pub masked: bool,
    /// The run's method, if any: its arrays take memory, and it may change the number of Gaussians.
    pub method: Option<Arc<dyn Method>>,
    /// Effects that pictures are rendered with.
    pub style: Style,
    /// True if the run begins with pictures of half their size.
    pub halves: bool,
    /// True if density control acts: it holds one array of both the old and the new model at once.
    pub grows: bool,
    /// Bytes that pruning needs besides the model; 0 if the run does not prune.
    pub pruning: u64,
    /// Bytes that an evaluation needs besides the model, while the renderer's buffers are freed.
    pub evaluation: u64,
}

impl Trainer {
    /// Peak device memory of a run, in bytes.
    pub fn bytes(device: &Device, needs: &TrainerNeeds) -> u64 {
        let &TrainerNeeds { gaussians, tail, pairs, size, degree, grows, .. } = needs;
        let n = gaussians + tail;
        let method = needs.method.as_deref();
        let arrays = method.map_or(0, |method| Array::bytes(method.arrays(), gaussians));
        let model = TrainingModel::bytes(n, tail, degree) + arrays;
        let uses = Uses { purpose: Purpose::Training, responses: false, style: needs.style };
        let renderer = Renderer::bytes(device, n, size, pairs, uses);
        let (photos, pixels) = (needs.photos.len(), size[0] as usize * size[1] as usize);
        let pictures = device.bytes_of(|counts| -> Result<()> {
            Loss::new(counts, size[0], size[1])?;
            HostCheck::new(counts)?;
            needs.exposure.then(|| Exposure::new(counts, &[], photos, pixels)).transpose()?;
            needs.masked.then(|| Mask::new(counts, pixels, [0.0; 3])).transpose()?;
            needs.halves.then(|| Halve::new(counts, size)).transpose()?;
            Ok(())
        });
        let poses = if needs.poses { Poses::bytes(photos) } else { 0 };
        let smoothing = if needs.style.antialias { Smoothing::bytes(photos) } else { 0 };
        let pictures = pictures + needs.depths + poses + smoothing;
        let pictures = pictures + DevicePhotos::bytes(&needs.photos, device.memory_limit());
        let growth = if grows || method.is_some() { density::bytes(device, n, n, degree) } else { 0 };
        // Downloads stage one array at a time; the widest are moments, twice as wide as their parameters.
        let widest = 8 * (n * Attributes::widest(degree)) as u64;
        let responding = Renderer::bytes(device, n, size, pairs, Uses { responses: true, ..uses }) - renderer;
        let pruning = if needs.pruning > 0 { needs.pruning + responding } else { 0 };
        let drawing = renderer + pruning.max(staging_bytes(widest));
        // The renderer's buffers are freed while the number of Gaussians changes and while views are scored.
        let released = Renderer::bytes(device, 1, [1, 1], 1, uses) + growth.max(needs.evaluation);
        let resting = Renderer::bytes(device, 1, [1, 1], 1, Uses { style: needs.style, ..Uses::default() });
        model + pictures + resting + drawing.max(released)
    }

    /// The largest buffer of a run that kernels bind: moments of the widest SH band, unless pictures or their pairs need more.
    pub fn largest_buffer(device: &Device, needs: &TrainerNeeds) -> LargestBuffer {
        let &TrainerNeeds { gaussians, tail, degree, grows, pruning, .. } = needs;
        let n = gaussians + tail;
        device.largest_of(|counts| -> Result<()> {
            moments::zeros_of(counts, gaussians, degree)?;
            let parameters = Attributes::NAMES.zip(Attributes::widths(degree));
            parameters.try_map(|(name, width)| counts.buffer::<f32>(name, n * width))?;
            for kind in needs.method.as_ref().map(|method| method.arrays()).unwrap_or_default() {
                counts.buffer::<f32>(kind.name, gaussians * kind.width)?;
            }
            if grows || needs.method.is_some() || pruning > 0 {
                // Rows of any array pass through it when the number of Gaussians changes.
                counts.buffer::<f32>("gathered rows", 2 * n * Attributes::widest(degree))?;
            }
            Self::bytes(counts, needs);
            Ok(())
        })
    }
}
