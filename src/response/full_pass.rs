//! Responses and scores from one pass over all views.

use super::{Gather, ResidentResponses, ResidentScores, Responses};
use crate::gaussians::resident::Resident;
use crate::gpu::{Buffer, Error, Recording};
use crate::render::{Backward, Renderer};
use crate::scene::camera::Camera;

/// The mean response over all `cameras`, view by view, and the scores of other methods if `with_scores`; deterministic.
///
/// For a view and its picture, `loss` records the gradient of the loss, with the residual in its fourth component, into
/// `image_gradient`, which has room for the largest view. The model does not change.
///
/// # Errors
/// Device memory; device errors; errors of `loss`.
///
/// # Panics
/// If the renderer was not made by [`Renderer::for_training`].
pub fn full_pass<E: From<Error>>(
    renderer: &mut Renderer,
    model: &Resident,
    cameras: &[Camera],
    image_gradient: &Buffer<[f32; 4]>,
    with_scores: bool,
    mut loss: impl FnMut(&mut Recording, usize, &Buffer<[f32; 4]>) -> std::result::Result<(), E>,
) -> std::result::Result<Responses, E> {
    let device = &renderer.device().clone();
    let responses = ResidentResponses::zeros(device, model.len)?;
    let scores = with_scores.then(|| ResidentScores::zeros(device, model.len)).transpose()?;
    let backward = Backward { residual: true, ..Backward::default() };
    let gather = Gather::Mean { views: cameras.len() as u32 };
    for (v, camera) in cameras.iter().enumerate() {
        renderer.make_room(model, camera)?;
        loop {
            let mut recording = Recording::new();
            renderer.reset_overflow(&mut recording);
            renderer.record(&mut recording, model, camera);
            loss(&mut recording, v, renderer.image())?;
            renderer.record_backward(&mut recording, model, camera, image_gradient, backward);
            responses.record(&mut recording, renderer, model, camera, gather);
            if let Some(scores) = &scores {
                scores.record(&mut recording, renderer, model, camera);
            }
            device.run(recording)?;
            // A view whose pairs did not fit has changed nothing.
            if !renderer.make_room_for_pairs(renderer.pairs()?)? {
                break;
            }
        }
    }
    let scores = scores.map(|s| s.values.read(device)).transpose()?;
    Ok(Responses { channels: responses.read(device, gather)?, scores: scores.unwrap_or_default() })
}
