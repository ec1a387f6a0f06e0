//! A step of Adam as data: learning rates, decays, and the pressure of attrition.

use crate::gaussians::Attributes;
use crate::kernels::constants::adam::float64::{BETA1, BETA2};

/// Learning rates of one step, in units of the stored parameters.
pub type Rates = Attributes<f32>;

/// Attrition's addition to the gradient of every opacity logit: see [`crate::reference::adam::pressed`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pressure {
    /// Amount added to each gradient, in units of the loss per logit.
    pub pressure: f32,
    /// Least value of 1 - opacity, by which the pressure is divided.
    pub least_through: f32,
}

/// A step of Adam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Its number; the first is 1.
    pub number: u32,
    /// Learning rates.
    pub rates: Rates,
    /// Pressure on opacities, if there is any.
    pub pressure: Option<Pressure>,
    /// Decays of the first and second moments.
    pub decays: [f64; 2],
}

impl Step {
    /// A step without pressure, with the reference's decays.
    pub fn new(number: u32, rates: Rates) -> Self {
        Self { number, rates, pressure: None, decays: [BETA1, BETA2] }
    }
}
