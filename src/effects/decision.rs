//! The decision to simulate an effect, with its evidence.

use super::effect::Effect;
use serde::Serialize;

/// The decision on one effect, with the evidence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    /// The effect.
    pub name: Effect,
    /// True if it is simulated.
    pub on: bool,
    /// True if the user decided, not the scene.
    pub forced: bool,
    /// True if the measure is so close to its threshold that the other choice may do as well.
    pub near_threshold: bool,
    /// The measure; null if there was nothing to measure.
    pub measured: Option<f64>,
    /// The scene calls for the effect above this value; null if the decision has no threshold.
    pub threshold: Option<f64>,
    /// SH degree; only for [`Effect::ViewDependence`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub degree: Option<usize>,
    /// Device seconds of training spent on it; null if it has no stage of its own, or nothing was trained.
    pub seconds: Option<f64>,
    /// The evidence, in a sentence.
    pub evidence: String,
}

/// Returns true if a measure is within a quarter of its threshold, so that the other choice may do as well.
pub(super) fn is_near(measured: f64, threshold: f64) -> bool {
    measured > threshold / 1.25 && measured < threshold * 1.25
}

/// Returns true if an effect is on among decisions.
pub fn is_on(decisions: &[Decision], effect: Effect) -> bool {
    decisions.iter().any(|d| d.name == effect && d.on)
}

impl Decision {
    /// The decision from a comparison of a number with its threshold.
    pub(super) fn by(name: Effect, measured: f64, threshold: f64, evidence: String) -> Self {
        Self {
            near_threshold: is_near(measured, threshold),
            measured: measured.is_finite().then_some(measured),
            threshold: Some(threshold),
            ..Self::plain(name, measured > threshold, evidence)
        }
    }

    /// Returns true if the scene is to decide, and nothing measured it.
    pub fn is_untold(&self) -> bool {
        !self.forced && self.measured.is_none()
    }

    /// The decision on view dependence for a model without photos.
    pub fn of_degree(degree: usize, evidence: String) -> Self {
        Self { degree: Some(degree), ..Self::plain(Effect::ViewDependence, degree > 0, evidence) }
    }

    /// The decision without a number.
    pub(super) fn plain(name: Effect, on: bool, evidence: String) -> Self {
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
