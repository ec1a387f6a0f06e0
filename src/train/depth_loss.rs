//! Depth as a loss: in some iterations the Gaussians in front of a photo with a depth map are drawn once more, with their depths as
//! colours, and what lies at another depth than the map's is moved there, or fades.

use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Device, Groups, Recording, Result};
use crate::kernels::constants::depth_loss::{COLOURS, GRADIENT};
use crate::kernels::train::{DepthLoss as Kernel, DepthLossPush as Push, DepthLossSpec as Spec};
use crate::primitives::WORKGROUP;
use crate::render::{Backward, TrainingRenderer};
use crate::scene::camera::Camera;
use crate::scene::{DepthMap, Photo};

/// The profiler's scope.
const SCOPE: &str = "depth loss";

/// One iteration in this many has the loss.
pub const EVERY: u32 = 4;
/// Weight of the mean over a picture's pixels, at the beginning of a run and at its end, as if every iteration had the loss.
const WEIGHTS: (f64, f64) = (0.5, 0.05);

/// Weight in iteration `iteration` of a run of `length`; 0 in those without the loss.
pub fn weight(iteration: u32, length: u32) -> f32 {
    let t = f64::from(iteration.min(length)) / f64::from(length.max(1));
    let (begin, end) = WEIGHTS;
    if iteration.is_multiple_of(EVERY) { (f64::from(EVERY) * begin * (end / begin).powf(t)) as f32 } else { 0.0 }
}

/// The depth maps of a run's photos on the device.
pub struct DepthLoss {
    /// All maps, one after the other.
    maps: Buffer<f32>,
    /// By photo: where its map begins, the map's width and height, and its unit in the world's.
    places: Vec<Option<(u32, [u32; 2], f32)>>,
}

impl DepthLoss {
    /// The maps of those photos that have one; none if none has.
    pub fn new(device: &Device, photos: &[Photo]) -> Result<Option<Self>> {
        let (mut all, mut places) = (Vec::new(), Vec::with_capacity(photos.len()));
        for photo in photos {
            places.push(photo.depth.as_ref().map(|map| (all.len() as u32, [map.width, map.height], map.unit as f32)));
            all.extend(photo.depth.iter().flat_map(|DepthMap { depths, .. }| depths.iter().copied()));
        }
        (!all.is_empty()).then(|| Ok(Self { maps: device.upload("depth maps", &all)?, places })).transpose()
    }

    /// Records a pass that adds the loss's gradients to the rows of photo `photo`'s picture, after
    /// [`TrainingRenderer::record_backward`]; nothing if the photo has no map, or with a weight of 0. It overwrites the picture, its
    /// colours, and `gradient`.
    pub fn record(
        &self,
        recording: &mut Recording,
        renderer: &TrainingRenderer,
        (model, camera): (&Resident, &Camera),
        (photo, weight): (usize, f32),
        gradient: &Buffer<[f32; 4]>,
    ) {
        let Some((first, size, unit)) = self.places[photo].filter(|_| weight > 0.0) else { return };
        let slots = renderer.slots(camera);
        let pixels = camera.width * camera.height;
        let phase = |recording: &mut Recording, phase: u32, groups: Groups<'_>| {
            let kernel = Kernel {
                view: slots.view,
                count: &model.count.value,
                tile_counts: slots.tile_counts,
                depth: slots.depth,
                shape: slots.shape,
                colour: slots.colour,
                image: renderer.image(),
                maps: &self.maps,
                gradient,
                push: Push { size, first, unit, weight: weight / pixels as f32 },
                spec: Spec { workgroup: WORKGROUP, phase },
            };
            recording.scope(SCOPE, |r| r.dispatch(&kernel, groups));
        };
        phase(recording, COLOURS, model.count.groups(WORKGROUP));
        renderer.record_blending(recording, camera);
        phase(recording, GRADIENT, Groups::Count(pixels.div_ceil(WORKGROUP)));
        let backward = Backward { depths: true, through_direction: false, ..Backward::default() };
        renderer.record_backward(recording, model, camera, gradient, backward);
    }
}
