//! 3D smoothing, part of anti-aliasing: no Gaussian becomes thinner than the photos can resolve.

use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Recording, Result};
use crate::kernels::View;
use crate::kernels::train::{Smoothing as Kernel, SmoothingPush, SmoothingSpec};
use crate::primitives::{Count, WORKGROUP};
use crate::render::{Settings, view};
use crate::scene::Photo;

/// Iterations between two smoothings: scales change by a fifth at most in between.
const EVERY: u32 = 16;

/// The cameras of all training photos.
pub struct Smoothing {
    views: Buffer<View>,
}

impl Smoothing {
    /// Bytes of [`Smoothing::new`].
    pub fn bytes(views: usize) -> u64 {
        Buffer::<View>::bytes_of(views)
    }

    /// The smoothing for these photos.
    pub fn new(device: &Device, photos: &[Photo], settings: &Settings) -> Result<Self> {
        let cameras: Vec<View> = photos.iter().map(|p| view(&p.camera, settings, 0, 1)).collect();
        Ok(Self { views: device.upload("training cameras", &cameras)? })
    }

    /// Returns true if smoothing is due after iteration `iteration` of `last`; every run ends with one.
    pub fn due(iteration: u32, last: u32) -> bool {
        iteration.is_multiple_of(EVERY) || iteration == last
    }

    /// Records the raising of scales to at least [`crate::reference::smoothing::least_scale`], in the counted rows.
    pub fn record(&self, recording: &mut Recording, model: &Resident, count: &Count) {
        let kernel = Kernel {
            view: &self.views,
            count: &count.value,
            means: &model.parameters.means,
            log_scales: &model.parameters.log_scales,
            push: SmoothingPush { views: self.views.len() as u32 },
            spec: SmoothingSpec { workgroup: WORKGROUP },
        };
        recording.scope("antialias", |r| r.dispatch(&kernel, count.groups(WORKGROUP)));
    }
}
