//! What a training run will need of the device's memory, before it begins.

use super::density;
use super::device_photos::DevicePhotos;
use super::exposure::Exposure;
use super::halve::Halve;
use super::loss::Loss;
use super::mask::Mask;
use super::smoothing::Smoothing;
use super::trainee::Trainee;
use super::trainer::Trainer;
use crate::gaussians::Gaussians;
use crate::gpu::{Device, staging_bytes};
use crate::render::{Renderer, Style, Uses};

/// What a run's memory depends on.
#[derive(Clone, Debug)]
pub struct Demand {
    /// Gaussians at most.
    pub gaussians: usize,
    /// (tile, Gaussian) pairs of a picture at most.
    pub pairs: u32,
    /// Width and height that every picture fits in.
    pub size: [u32; 2],
    /// Bytes of each photo.
    pub photos: Vec<u64>,
    /// Highest SH degree.
    pub degree: usize,
    /// Whether photos get exposures of their own.
    pub exposure: bool,
    /// Whether photos have masks.
    pub masked: bool,
    /// How pictures are drawn.
    pub style: Style,
    /// Whether the run begins with pictures of half their size.
    pub halves: bool,
    /// Whether density control acts: it holds the old model and the new at once, as the renderer does when it grows.
    pub grows: bool,
    /// Bytes that pruning takes beside the model while it lasts; 0 where the run does not prune.
    pub pruning: u64,
}

impl Trainer {
    /// Bytes of device memory that a run takes at its height.
    pub fn bytes(device: &Device, demand: &Demand) -> u64 {
        let &Demand { gaussians: n, pairs, size, degree, grows, .. } = demand;
        let model = Trainee::bytes(n, degree);
        let uses = Uses { training: true, depth_order: demand.style.depth_order };
        let renderer = Renderer::bytes(device, n * 5 / 4, size, pairs, uses);
        let pictures =
            DevicePhotos::bytes(&demand.photos, device.memory_limit()) + Loss::bytes(device, size[0], size[1]);
        let pixels = size[0] as usize * size[1] as usize;
        let exposures = if demand.exposure { Exposure::bytes(demand.photos.len(), pixels) } else { 0 };
        let pictures = pictures + exposures + if demand.masked { Mask::bytes(pixels) } else { 0 };
        let pictures = pictures + if demand.halves { Halve::bytes(size) } else { 0 };
        let pictures = pictures + if demand.style.antialias { Smoothing::bytes(demand.photos.len()) } else { 0 };
        let growth = if grows { density::bytes(device, n, n, degree).max(renderer) } else { 0 };
        // The widest array is what downloads stage; its moments are twice as wide.
        let widest = 8 * (n * Gaussians::band_width(degree)) as u64;
        let passing = growth.max(demand.pruning).max(staging_bytes(widest));
        model + renderer + pictures + passing
    }
}
