//! The effects by name, with their triggers.

use crate::wording::{named, unknown};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};

named! {
    /// A part of image formation or training that not every scene needs.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Effect {
        /// Colour depends on the direction of view: SH bands 1 to 3.
        ViewDependence = "view_dependence",
        /// Each photo has an exposure of its own: a 3 x 4 affine of the colours.
        Exposure = "exposure",
        /// The photos' cameras are corrected while the model is trained.
        Poses = "poses",
        /// Each picture trained on leaves out Gaussians by chance.
        Dropout = "dropout",
        /// Pictures are compared with the photos' depth maps, too.
        Depth = "depth",
        /// Far Gaussians are added at the start where photos show a sky.
        Sky = "sky",
        /// Gaussians smaller than a pixel keep their energy.
        Antialias = "antialias",
        /// Photos are undistorted.
        Distortion = "distortion",
        /// Alpha is opacity over the background.
        Transparency = "transparency",
        /// Masked parts of photos are not trained on.
        Masks = "masks",
        /// Photos have several sizes or intrinsics.
        Cameras = "cameras",
        /// Each tile orders Gaussians by the depths along its own ray.
        DepthOrder = "depth_order",
    }
}

/// Condition that switches an effect on unless the user decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// A measure of the scene passes a threshold; other scenes can be trained with the effect, too.
    Measure,
    /// The photos have a property, such as masks, without which there is nothing to simulate.
    Photos,
    /// No measure: the effect is on only at the user's request.
    Request,
    /// No measure: the effect costs nothing and is always simulated.
    Always,
}

impl Effect {
    /// The effects that can be switched.
    pub fn settable() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(|effect| effect.trigger() != Trigger::Always)
    }

    /// The effect of this name.
    ///
    /// # Errors
    /// A sentence that names the effects that can be switched.
    pub fn named(name: &str) -> Result<Self, String> {
        let effect = Self::ALL.into_iter().find(|effect| effect.name() == name);
        effect.ok_or_else(|| unknown(name, "an effect", Self::settable().map(Self::name)))
    }

    /// Condition that switches the effect on unless the user decides.
    pub const fn trigger(self) -> Trigger {
        match self {
            Self::ViewDependence | Self::Exposure | Self::Poses | Self::Dropout | Self::Sky | Self::Antialias => {
                Trigger::Measure
            }
            Self::Depth | Self::Distortion | Self::Transparency | Self::Masks => Trigger::Photos,
            Self::DepthOrder => Trigger::Request,
            Self::Cameras => Trigger::Always,
        }
    }

    /// The profiler scope that measures this effect's time alone; `None` if its time is part of other stages.
    pub const fn scope(self) -> Option<&'static str> {
        match self {
            Self::Exposure => Some("exposure"),
            Self::Poses => Some("poses"),
            Self::Dropout => Some("dropout"),
            Self::Depth => Some("depth loss"),
            Self::Masks => Some("masks"),
            // The 2D filter is two operations of the projection; the scope is that of 3D smoothing.
            Self::Antialias => Some("antialias"),
            Self::DepthOrder => Some("depth order"),
            Self::ViewDependence | Self::Sky | Self::Distortion | Self::Transparency | Self::Cameras => None,
        }
    }
}

impl<'de> Deserialize<'de> for Effect {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::named(&String::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}
