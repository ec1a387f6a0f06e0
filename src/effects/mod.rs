//! Floor 4: what a scene calls for, found from its training photos, cameras and points alone, with the evidence.
//!
//! | effect | called for when | is decided in | what it switches |
//! |---|---|---|---|
//! | `view_dependence` | colours of a point depend on where it is seen from; degree 1 where they do not | [`colour`] | SH bands: arrays, moments, gradients |
//! | `exposure` | photos differ in brightness by more than 2 % | [`colour`] | `train/exposure`: 12 parameters a photo, its scope "exposure" |
//! | `antialias` | a point's pixel footprints differ by more than 1.5 | [`geometry`] | ANTIALIAS of `render/project` and its backward; `train/smoothing`: its cameras, its scope "antialias" |
//! | `distortion` | a lens moves a pixel by more than 0.5 | [`geometry`] | photos are resampled once as they are loaded |
//! | `transparency` | photos have transparent pixels | [`geometry`] | ALPHA of `train/loss`, the white background |
//! | `masks` | photos have masks | [`geometry`] | `train/mask`: its picture, its scope "masks" |
//! | `cameras` | sizes or intrinsics differ | [`geometry`] | nothing: a view's uniforms are its own |
//! | `depth_order` | on request | here | DEPTH_ORDER of `render/bin`: a sort of the pairs, their tiles, its scope "depth order" |

pub mod colour;
pub mod geometry;
mod thumbnail;
mod tracks;

use crate::scene::Scene;
use colour::Gains;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

pub use thumbnail::{Thumbnail, WIDTH as THUMBNAIL_WIDTH};

/// A part of image formation or training that not every scene needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Effect {
    /// Colour by direction: SH bands 1 to 3.
    ViewDependence,
    /// A 3 x 4 affine of the colours of each photo.
    Exposure,
    /// Gaussians smaller than a pixel keep their energy.
    Antialias,
    /// Photos are undistorted.
    Distortion,
    /// Alpha is opacity over the background.
    Transparency,
    /// Parts of photos are not trained on.
    Masks,
    /// Several sizes or intrinsics.
    Cameras,
    /// Each tile orders Gaussians by the depths that its own ray sees.
    DepthOrder,
}

impl Effect {
    /// All, in the order of the table.
    pub const ALL: [Self; 8] = [
        Self::ViewDependence,
        Self::Exposure,
        Self::Antialias,
        Self::Distortion,
        Self::Transparency,
        Self::Masks,
        Self::Cameras,
        Self::DepthOrder,
    ];

    /// Its name in files and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ViewDependence => "view_dependence",
            Self::Exposure => "exposure",
            Self::Antialias => "antialias",
            Self::Distortion => "distortion",
            Self::Transparency => "transparency",
            Self::Masks => "masks",
            Self::Cameras => "cameras",
            Self::DepthOrder => "depth_order",
        }
    }

    /// The profiler's scope that counts its time alone; none where its time is part of another stage's.
    pub const fn scope(self) -> Option<&'static str> {
        match self {
            Self::Exposure => Some("exposure"),
            Self::Masks => Some("masks"),
            // The 2D filter is two operations of the projection.
            Self::Antialias => Some("antialias"),
            Self::DepthOrder => Some("depth order"),
            _ => None,
        }
    }

    /// Why it cannot be set; none where it can.
    const fn fixed(self) -> Option<&'static str> {
        match self {
            Self::Cameras => Some("every view has uniforms of its own, at no cost: there is nothing to switch"),
            _ => None,
        }
    }
}

/// Who decides on an effect.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Choice {
    /// The scene.
    #[default]
    Auto,
    /// The user: on.
    On,
    /// The user: off.
    Off,
}

/// What the user decided; all else is left to the scene.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Overrides(BTreeMap<Effect, Choice>);

impl Overrides {
    /// Reads `NAME=on|off|auto`.
    ///
    /// # Errors
    /// A sentence that says what is wrong.
    pub fn parse(text: &str) -> Result<(Effect, Choice), String> {
        let names = || Effect::ALL.map(Effect::name).join(", ");
        let (name, value) =
            text.split_once('=').ok_or_else(|| format!("write NAME=on, NAME=off or NAME=auto; names: {}", names()))?;
        let effect = Effect::ALL.into_iter().find(|e| e.name() == name.trim());
        let effect = effect.ok_or_else(|| format!("there is no effect '{name}'; names: {}", names()))?;
        let choice = match value.trim() {
            "auto" => Choice::Auto,
            "on" => Choice::On,
            "off" => Choice::Off,
            other => return Err(format!("'{other}' is none of on, off and auto")),
        };
        Ok((effect, choice))
    }

    /// Sets one; the last word counts.
    pub fn set(&mut self, effect: Effect, choice: Choice) {
        match choice {
            Choice::Auto => self.0.remove(&effect),
            _ => self.0.insert(effect, choice),
        };
    }

    /// Whether every effect is left to the scene.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Who decides on this one.
    pub fn of(&self, effect: Effect) -> Choice {
        self.0.get(&effect).copied().unwrap_or_default()
    }

    /// On or off where the user said so.
    pub fn forced(&self, effect: Effect) -> Option<bool> {
        match self.of(effect) {
            Choice::Auto => None,
            Choice::On => Some(true),
            Choice::Off => Some(false),
        }
    }

    /// Refuses what cannot be set.
    ///
    /// # Errors
    /// A sentence that says why.
    pub fn check(&self) -> Result<(), String> {
        for effect in self.0.keys() {
            if let Some(why) = effect.fixed() {
                return Err(format!("effect {} cannot be set: {why}", effect.name()));
            }
        }
        Ok(())
    }
}

/// What was decided on one effect, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    /// The effect.
    pub name: Effect,
    /// Whether it is simulated.
    pub on: bool,
    /// Whether the user said so, not the scene.
    pub forced: bool,
    /// Whether the measure lies so near its threshold that the other choice may do as well.
    pub near_threshold: bool,
    /// What was measured; null where there was nothing to measure.
    pub measured: Option<f64>,
    /// Above this the scene calls for the effect; null where that is not a matter of degree.
    pub threshold: Option<f64>,
    /// SH degree, of [`Effect::ViewDependence`] alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub degree: Option<usize>,
    /// Device seconds of training that it took; null where it has no stage of its own, or nothing was trained.
    pub seconds: Option<f64>,
    /// The evidence, in a sentence.
    pub evidence: String,
}

/// Whether a measure lies within a quarter of its threshold, so that the other choice may do as well.
fn is_near(measured: f64, threshold: f64) -> bool {
    measured > threshold / 1.25 && measured < threshold * 1.25
}

impl Decision {
    /// By a number against its threshold.
    fn by(name: Effect, measured: f64, threshold: f64, evidence: String) -> Self {
        Self {
            near_threshold: is_near(measured, threshold),
            measured: measured.is_finite().then_some(measured),
            threshold: Some(threshold),
            ..Self::plain(name, measured > threshold, evidence)
        }
    }

    /// On view dependence, for a model that has no photos.
    pub fn of_degree(degree: usize, evidence: String) -> Self {
        Self { degree: Some(degree), ..Self::plain(Effect::ViewDependence, degree > 0, evidence) }
    }

    /// Without a number.
    fn plain(name: Effect, on: bool, evidence: String) -> Self {
        Self {
            name,
            on,
            forced: false,
            near_threshold: false,
            measured: None,
            threshold: None,
            degree: None,
            seconds: None,
            evidence,
        }
    }
}

/// What detectors look at: the scene, and the photos that are trained on.
pub struct TrainingSet<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Indices of the training views.
    pub train: &'a [usize],
    /// Their photos, in that order.
    pub photos: &'a [Thumbnail],
}

/// Decides on every effect, in the order of [`Effect::ALL`]. `most` is the highest SH degree allowed.
///
/// Whatever the user decided, the evidence is the scene's. Also gives the photos' gains.
pub fn decide(set: &TrainingSet<'_>, overrides: &Overrides, most: usize) -> (Vec<Decision>, Gains) {
    let tracks = tracks::observations(set);
    let gains = colour::gains(&tracks, set.photos.len());
    let mut decisions = vec![
        colour::view_dependence(&tracks, &gains, most),
        colour::exposure(set, &tracks, &gains),
        geometry::antialias(set),
        geometry::distortion(set),
        geometry::transparency(set),
        geometry::masks(set),
        geometry::cameras(set),
        Decision::plain(
            Effect::DepthOrder,
            false,
            "on request only; else Gaussians are sorted by depth once a picture".into(),
        ),
    ];
    for d in &mut decisions {
        let Some(on) = overrides.forced(d.name) else { continue };
        (d.on, d.forced) = (on, true);
        if d.name == Effect::ViewDependence {
            d.degree = Some(if on { most.max(1) } else { 0 });
        }
    }
    (decisions, gains)
}

/// Whether an effect is on among decisions.
pub fn is_on(decisions: &[Decision], effect: Effect) -> bool {
    decisions.iter().any(|d| d.name == effect && d.on)
}

/// The value at a share of sorted values; 0 of none.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(((values.len().max(1) - 1) as f64 * share).round() as usize).copied().unwrap_or(0.0)
}
