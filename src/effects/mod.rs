//! Decides which effects a scene calls for, from its training photos, cameras and points alone, with the
//! evidence. [`Agreement`] tells from all photos which of them do not show what their poses should.
//!
//! `docs/effects.md` tells when each effect is on and what it costs, and `docs/engine.md` how another one is added. The compiler asks
//! for a new one's trigger, scope and detector.

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
            let evidence = "only on request; otherwise Gaussians are sorted by depth once per picture";
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
