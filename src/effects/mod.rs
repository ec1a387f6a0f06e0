//! Decides which effects a scene calls for, from its training photos, cameras and points alone, with the
//! evidence. [`Agreement`] tells from all photos which of them do not show what their poses should.
//!
//! `docs/effects.md` tells when each effect is on and what it costs, and `docs/engine.md` how another one is added. The compiler asks
//! for a new one's trigger, scope and detector.

mod agreement;
pub mod colour;
mod decision;
mod doubts;
mod effect;
pub mod geometry;
mod overrides;
mod quantile;
mod sights;
pub mod sky;
mod tracks;
mod training_set;
mod trial;

pub use agreement::Agreement;
pub use decision::{Decision, is_on};
pub use doubts::Doubts;
pub use effect::{Effect, Trigger};
pub use geometry::antialias_would_help;
pub use overrides::{Choice, Overrides};
pub use sights::Change;
pub use training_set::{DepthEvidence, DepthWitness, THUMBNAIL_WIDTH, Thumbnail, TrainingSet};
pub use trial::{MOVED, exposure_by_trial, poses_by_trial, trial_length, untold};

use crate::scene::Point;
use colour::Gains;

/// The results of [`decide`] for a training set.
pub struct Told {
    /// The decision on each effect, in the order of [`Effect::ALL`].
    pub decisions: Vec<Decision>,
    /// Gains of the photos.
    pub gains: Gains,
    /// Points of the sky; none if that effect is off.
    pub sky: Vec<Point>,
}

/// Decides on every effect. `most` is the highest SH degree allowed.
///
/// The evidence always comes from the scene, also for effects that the user decided.
pub fn decide(set: &TrainingSet<'_>, overrides: &Overrides, most: usize) -> Told {
    let tracks = tracks::observations(set);
    let untracked = if tracks.is_empty() { tracks::projected(set) } else { Vec::new() };
    let strong = Some(colour::gains(&untracked, set.photos.len())).filter(Gains::are_strong);
    let common = if strong.is_some() { &untracked } else { &tracks };
    let gains = strong.unwrap_or_else(|| colour::gains(&tracks, set.photos.len()));
    let (on_sky, mut sky) = sky::sky(set);
    let detect = |effect: Effect| match effect {
        Effect::ViewDependence => colour::view_dependence(&tracks, &gains, most),
        Effect::Exposure => colour::exposure(set, common, &gains),
        Effect::Poses => geometry::poses(set),
        Effect::Dropout => geometry::dropout(set),
        Effect::Depth => geometry::depth(set),
        Effect::Sky => on_sky.clone(),
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
        let there = if d.name == Effect::Sky { !sky.is_empty() } else { set.has_input(d.name) };
        (d.on, d.forced, d.near_threshold) = (on && there, true, false);
        if d.name == Effect::ViewDependence {
            d.degree = Some(if on { most.max(1) } else { 0 });
        }
    }
    if !is_on(&decisions, Effect::Sky) {
        sky.clear();
    }
    Told { decisions, gains, sky }
}
