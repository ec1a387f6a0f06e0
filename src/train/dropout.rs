//! Dropout of Gaussians (DropGaussian, Park et al. 2025): each picture trained on leaves some out by chance, and the opacities
//! of the others rise. Where few photos see a place, no Gaussian can then paint one photo alone.

use crate::effects::geometry::{LOOKS, looks};
use crate::gaussians::resident::Resident;
use crate::gpu::Recording;
use crate::kernels::train::{Dropout as Kernel, DropoutPush as Push, DropoutSpec as Spec};
use crate::primitives::WORKGROUP;
use crate::render::TrainingRenderer;
use crate::scene::camera::Camera;

/// Shares of the Gaussians that pictures leave out at the end of a run: the paper's, and the largest (docs/decisions.md, 140).
const SHARES: [f64; 2] = [0.2, 0.4];

/// Share left out in iteration `iteration` of a run of `length` on `photos` photos: it grows with the run, and further the more
/// often the run trains on each photo.
pub fn share(iteration: u32, length: u32, photos: usize) -> f32 {
    let [least, most] = SHARES;
    let last = (least * (looks(length, photos) / LOOKS).sqrt()).clamp(least, most);
    (last * f64::from(iteration.min(length)) / f64::from(length.max(1))) as f32
}

/// Records the choice for a picture, between [`crate::render::Renderer::record_lists`] and
/// [`crate::render::Renderer::record_blending`]. `key` is the run's seed and the iteration.
pub fn record(
    recording: &mut Recording,
    renderer: &TrainingRenderer,
    (model, camera): (&Resident, &Camera),
    [seed, iteration]: [u32; 2],
    share: f32,
) {
    let slots = renderer.slots(camera);
    let kernel = Kernel {
        pairs: slots.pairs,
        count: &model.count.value,
        tile_counts: slots.tile_counts,
        shape: slots.shape,
        push: Push { pair_limit: slots.limit, seed, iteration, share },
        spec: Spec { workgroup: WORKGROUP },
    };
    recording.scope("dropout", |r| r.dispatch(&kernel, model.count.groups(WORKGROUP)));
}
