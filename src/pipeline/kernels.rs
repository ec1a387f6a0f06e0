//! The kernels of a run, compiled but not run, for the statistics of the device's compiler.

use super::prune::{PruneRequest, plan};
use crate::gaussians::Gaussians;
use crate::gpu::{Compiled, Device};
use crate::job::{Error, Preset};
use crate::qirf::participation::Eigensolver;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::Keep;
use crate::response::Wanted;
use crate::scene::Photo;
use crate::scene::camera::Camera;
use crate::train::schedule::Schedule;
use crate::train::{Options, Trainer};
use glam::DVec3;

/// Gaussians and picture for which kernels are shaped.
const GAUSSIANS: usize = 100_000;
const SIDE: u32 = 1024;

/// The driver's statistics of the kernels of an iteration, a response pass with scores, and a prune by each kind of solver,
/// with SH of degree 3. The device must have been opened with [`crate::gpu::DeviceOptions::compile_only`].
pub fn compiled(device: &Device) -> Result<Vec<Compiled>, Error> {
    let degree = 3;
    let along = |i: usize, k: usize| ((i * 31 + k * 17) % 101) as f32 / 50.0 - 1.0;
    let means = (0..GAUSSIANS).map(|i| [along(i, 0), along(i, 1), along(i, 2)]).collect();
    let model = Gaussians::balls(means, -4.0, 0.0, degree);
    let camera = Camera::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y, 0.8, SIDE, SIDE);
    let photo = Photo::opaque(camera, vec![0; (SIDE * SIDE * 4) as usize]);
    let options = Options { schedule: Schedule::default(), degree, ..Options::default() };
    let mut trainer = Trainer::new(device, &model, vec![photo], 1.0, options)?;
    device.submit(trainer.recording()?)?;
    let responses = trainer.responses(Wanted { residual: true, ..Wanted::BOTH })?;
    for (selector, solver) in [(Selector::Css, Eigensolver::Dsygvd), (Selector::Gnso, Eigensolver::Device)] {
        let mut compression = Preset::Quick.pruning().compression;
        (compression.selector, compression.basis.solver) = (selector, solver);
        let request = PruneRequest { compression: &compression, keep: Keep::Share(0.28), seed: 1 };
        plan(device, trainer.model().into(), &model, &responses, &request)?;
    }
    Ok(device.compiled())
}
