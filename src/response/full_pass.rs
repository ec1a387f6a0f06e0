//! Responses and scores from one pass over all views.

use super::{Gather, ResidentResponses, ResidentScores, ResidentSketches, Responses};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Error, Recording};
use crate::render::{Backward, Renderer};
use crate::scene::camera::Camera;

/// What a pass over all views gathers.
#[expect(clippy::struct_excessive_bools, reason = "parts of a pass, each on its own")]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// Response channels, which need the backward pass.
    pub channels: bool,
    /// Scores, which need the picture alone.
    pub scores: bool,
    /// True if scores compare pictures with photos, where there are photos.
    pub residual: bool,
    /// Sketches, which need the picture alone.
    pub sketches: bool,
}

impl Wanted {
    /// Response channels alone.
    pub const CHANNELS: Self = Self { channels: true, scores: false, residual: false, sketches: false };
    /// Scores alone, of the pictures as they are.
    pub const SCORES: Self = Self { channels: false, scores: true, ..Self::CHANNELS };
    /// Response channels and scores.
    pub const BOTH: Self = Self { scores: true, ..Self::CHANNELS };

    /// Bytes of device memory that the results take for `gaussians` Gaussians.
    pub fn bytes(self, gaussians: usize) -> u64 {
        let of = |wanted: bool, bytes: fn(usize) -> u64| if wanted { bytes(gaussians) } else { 0 };
        of(self.channels, ResidentResponses::bytes)
            + of(self.scores, ResidentScores::bytes)
            + of(self.sketches, ResidentSketches::bytes)
    }
}

/// What a gradient by the picture is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Term {
    /// The loss; the fourth component is the residual.
    Loss,
    /// Half the sum of the squared differences to the photo, so that the gradient is the difference.
    Squares,
}

/// The views of a pass.
pub struct Views<'a, F> {
    /// Their cameras.
    pub cameras: &'a [Camera],
    /// Receives the number of views done, before each view and after the last; its error ends the pass.
    pub follow: F,
}

/// The mean response over all views, one by one, and scores, as `wanted`; deterministic.
///
/// For a view and its picture, `gradient` records the gradient of a term into `image_gradient`, which has room for the largest
/// view. It is asked for squares only if a residual is wanted. The model does not change.
///
/// # Errors
/// Device memory; device errors; errors of `gradient` and of [`Views::follow`].
///
/// # Panics
/// If the renderer was not made by [`Renderer::for_training`].
pub fn full_pass<E: From<Error>>(
    renderer: &mut Renderer,
    model: &Resident,
    Views { cameras, mut follow }: Views<'_, impl FnMut(usize) -> std::result::Result<(), E>>,
    image_gradient: &Buffer<[f32; 4]>,
    wanted: Wanted,
    mut gradient: impl FnMut(&mut Recording, usize, &Buffer<[f32; 4]>, Term) -> std::result::Result<(), E>,
) -> std::result::Result<Responses, E> {
    let device = &renderer.device().clone();
    let responses = wanted.channels.then(|| ResidentResponses::zeros(device, model.len)).transpose()?;
    let scores = wanted.scores.then(|| ResidentScores::zeros(device, model.len)).transpose()?;
    let sketches = wanted.sketches.then(|| ResidentSketches::zeros(device, model.len)).transpose()?;
    let backward = Backward { residual: true, ..Backward::default() };
    let gather = Gather::Mean { views: cameras.len() as u32 };
    for (v, camera) in cameras.iter().enumerate() {
        follow(v)?;
        renderer.make_room(model, camera)?;
        loop {
            let mut recording = Recording::new();
            renderer.reset_overflow(&mut recording);
            renderer.record(&mut recording, model, camera);
            if let Some(responses) = &responses {
                gradient(&mut recording, v, renderer.image(), Term::Loss)?;
                renderer.record_backward(&mut recording, model, camera, image_gradient, backward);
                responses.record(&mut recording, renderer, model, camera, gather);
            }
            if let Some(scores) = &scores {
                if wanted.residual {
                    gradient(&mut recording, v, renderer.image(), Term::Squares)?;
                }
                scores.record(&mut recording, renderer, model, camera, wanted.residual.then_some(image_gradient));
            }
            if let Some(sketches) = &sketches {
                sketches.record(&mut recording, renderer, model, camera, v as u32);
            }
            device.run(recording)?;
            // A view whose pairs did not fit has changed nothing.
            if !renderer.make_room_for_pairs(renderer.pairs()?)? {
                break;
            }
        }
    }
    follow(cameras.len())?;
    let channels = responses.map(|r| r.read(device, gather)).transpose()?.unwrap_or_default();
    let scores = scores.map(|s| s.values.read(device)).transpose()?.unwrap_or_default();
    let sketches = sketches.map(|s| s.read(device)).transpose()?.unwrap_or_default();
    let dilation = renderer.settings().dilation;
    Ok(Responses { channels, scores, sketches, cameras: cameras.to_vec(), dilation })
}
