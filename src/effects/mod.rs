//! Decides which effects a scene calls for, from its training photos, cameras and points alone, with the
//! evidence. [`Agreement`] tells from all photos which of them do not show what their poses should.
//!
//! | effect | on when | detector | what it switches |
//! |---|---|---|---|
//! | `view_dependence` | colours of a point depend on the direction of view; otherwise degree 1 | [`colour`] | SH bands: arrays, moments, gradients |
//! | `exposure` | photos differ in brightness by more than 2 % | [`colour`] | `train/exposure`: 12 parameters per photo, its scope "exposure" |
//! | `poses` | points miss their places in the photos by more than a pixel | [`geometry`] | `train/poses`: 6 parameters per photo, its scope "poses" |
//! | `dropout` | at most 25 photos, none of them transparent, are trained on, and each more than 4.5 times as often as there are photos | [`geometry`] | `train/dropout`: its scope "dropout" |
//! | `depth` | depth maps of photos agree with the capture's points | [`geometry`] | `train/depth_loss`: a second picture in some iterations, its scope "depth loss" |
//! | `antialias` | a point's pixel footprints differ by more than 1.5 | [`geometry`] | ANTIALIAS of `render/project` and its backward; `train/smoothing`: its cameras, its scope "antialias" |
//! | `distortion` | a lens moves a pixel by more than 0.5 | [`geometry`] | photos are resampled once as they are loaded |
//! | `transparency` | photos have transparent pixels | [`geometry`] | ALPHA of `train/loss`, the white background |
//! | `masks` | photos have masks | [`geometry`] | `train/mask`: its picture, its scope "masks" |
//! | `cameras` | sizes or intrinsics differ | [`geometry`] | nothing: a view's uniforms are its own |
//! | `depth_order` | on request | none | DEPTH_ORDER of `render/bin`: a sort of the pairs, their tiles, its scope "depth order" |
//!
//! # Adding an effect
//! 1. Name it in `effect.rs` and in the table above; the compiler then asks for its trigger, its scope and its detector
//!    (in [`decide`]).
//! 2. If a model trained with it must be rendered with it, give [`Style`](crate::render::Style) a field, set it in
//!    `style` of `pipeline/effects.rs`, and give it an option in `cli/style.rs`. Configuration, records and memory
//!    estimates carry the whole style. If photos carry it, extend [`Photo`](crate::scene::Photo) and its loading.
//! 3. Write the kernel's part under a specialization constant, its host's part (with the bytes that it takes beside the
//!    buffers) and its twin in `reference/`.
//! 4. Test that it does what it should and that it is free when off (`tests/device/effects/`), add a check to
//!    `selftest`, a row to `benches/engine/effects.rs` and a section to `docs/effects.md`.

mod agreement;
pub mod colour;
mod decision;
mod effect;
pub mod geometry;
mod overrides;
mod quantile;
mod sights;
mod tracks;
mod training_set;
mod trial;

pub use agreement::Agreement;
pub use decision::{Decision, is_on};
pub use effect::{Effect, Trigger};
pub use overrides::{Choice, Overrides};
pub use sights::Change;
pub use training_set::{DepthEvidence, DepthWitness, THUMBNAIL_WIDTH, Thumbnail, TrainingSet};
pub use trial::{MOVED, exposure_by_trial, poses_by_trial, trial_length, untold};

use colour::Gains;

/// Decides on every effect, in the order of [`Effect::ALL`]; also returns the gains of the photos. `most` is the
/// highest SH degree allowed.
///
/// The evidence always comes from the scene, also for effects that the user decided.
pub fn decide(set: &TrainingSet<'_>, overrides: &Overrides, most: usize) -> (Vec<Decision>, Gains) {
    let tracks = tracks::observations(set);
    let gains = colour::gains(&tracks, set.photos.len());
    let detect = |effect: Effect| match effect {
        Effect::ViewDependence => colour::view_dependence(&tracks, &gains, most),
        Effect::Exposure => colour::exposure(set, &tracks, &gains),
        Effect::Poses => geometry::poses(set),
        Effect::Dropout => geometry::dropout(set),
        Effect::Depth => geometry::depth(set),
        Effect::Antialias => geometry::antialias(set),
        Effect::Distortion => geometry::distortion(set),
        Effect::Transparency => geometry::transparency(set),
        Effect::Masks => geometry::masks(set),
        Effect::Cameras => geometry::cameras(set),
        Effect::DepthOrder => {
            let evidence = "on request only; else Gaussians are sorted by depth once a picture";
            Decision::plain(effect, false, evidence.to_owned())
        }
    };
    let mut decisions = Effect::ALL.map(detect).to_vec();
    for d in &mut decisions {
        let Some(on) = overrides.forced(d.name) else { continue };
        let there = set.has_input(d.name);
        (d.on, d.forced, d.near_threshold) = (on && there, true, false);
        if d.name == Effect::ViewDependence {
            d.degree = Some(if on { most.max(1) } else { 0 });
        }
    }
    (decisions, gains)
}
